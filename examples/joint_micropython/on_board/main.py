"""This board's joint: `main.py rig` is called by the rig through stdin and stdout, any other plays on a CAN bus.

`main.py vcan0` plays on SocketCAN, under the unix port; `main.py` on whatever can_bus.py of a board's own opens.
"""

import sys

from joint import make_joint

STOPPED, CHANNEL = 6, 4
"""Exit codes, as those of hil: the run did not come to its end; the bus does not work."""


def main(words):
    """Play; return an exit code."""
    joint = make_joint()
    if words == ["rig"]:
        from by_calls import serve

        serve(joint)
        return 0
    from by_frames import serve
    from can_bus import Bus

    try:
        bus = Bus(joint.wakes_on + joint.stores, *words[:1])
        print(joint.name + ": waits for the set-up")
        serve(joint, bus)
    except OSError as error:
        print(joint.name + ":", error, file=sys.stderr)
        return CHANNEL
    print(joint.name + ": the run is over;", joint.report())
    return STOPPED if joint.fault else 0


sys.exit(main(sys.argv[1:]))
