"""Two nodes queue a frame at the same instant, three times: docs/bus.md does the sums.

hil bus arm --expect left,right
"""

from concurrent.futures import ThreadPoolExecutor

import can


def node(name, identifier):
    """Send at 0, 1 and 2 ms of virtual time; return what was heard, and when."""
    heard = []
    with can.Bus(interface="hil", channel="arm", name=name, timed=True, wait_s=10) as bus:
        for number, length in enumerate((4, 6, 8)):
            bus.send(can.Message(arbitration_id=identifier, data=b"\x55" * length, is_extended_id=False))
            message = bus.recv()
            heard.append((message.timestamp, f"{name} hears {message.arbitration_id:X}, {message.dlc} bytes"))
            bus.recv(timeout=(number + 1) * 1e-3 - message.timestamp)
    return heard


with ThreadPoolExecutor() as pool:
    both = pool.map(node, ("left", "right"), (0x155, 0x321))
    for seconds, text in sorted(line for heard in both for line in heard):
        print(f"{seconds * 1e6:4.0f} us  {text}")
