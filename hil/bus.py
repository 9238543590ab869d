"""`hil bus`: the wire as a server, one session after the other, until it is told to end.

With expected clients time waits for them, and a session is over when they have left; the next one begins anew. Without,
whoever joins is served: virtual time goes as fast as the timed clients answer, and at real time while there are none.
"""

import time
from collections.abc import Callable, Sequence

from hil.drive import RUN_IS_OVER
from hil.errors import NodeError
from hil.watchdog import watchdog
from hil.wire.channel import Listener
from hil.wire.kernel import Kernel
from hil.wire.participants import FAR_NS, Observer
from hil.wire.server import Server

POLL_S = 0.02

Say = Callable[[str], None]


def serve(channel: str, expect: Sequence[str], bit_ns: int, functional: bool, say: Say) -> None:
    """Serve a channel for ever; raise ChannelError if another bus holds it. Observers stay from session to session."""
    listener = Listener(channel)
    observers: list[Observer] = []
    try:
        while True:
            server = Server(listener, Kernel(bit_ns, functional), expect, watchdog(say), observers)
            reason, go_on = "the bus ends", False
            try:
                if expect:
                    _session(server, channel, say)
                else:
                    _open(server, channel, say)
                reason, go_on = RUN_IS_OVER, True
            except NodeError as error:
                reason, go_on = str(error), True
                say(f"session ended at {server.kernel.now_ns * 1e-9:.6f} s: {error}")
            finally:
                observers = server.end(reason, keep_observers=go_on)
    finally:
        listener.close()


def _session(server: Server, channel: str, say: Say) -> None:
    awaited: list[str] = []
    while missing := server.missing():
        if missing != awaited:
            say(f"bus {channel!r}: waiting for {', '.join(missing)}")
            awaited = missing
        server.poll(POLL_S)
    say(f"bus {channel!r}: everybody is there, time begins")
    frames = _count_frames(server.kernel)
    server.start()
    server.run(FAR_NS)
    say(f"bus {channel!r}: session over at {server.kernel.now_ns * 1e-9:.6f} s, {frames[0]} frames")


def _open(server: Server, channel: str, say: Say) -> None:
    say(f"bus {channel!r}: open to everybody; Ctrl-C ends it")
    kernel = server.kernel
    server.start()
    while not server.deserted:
        if server.timed:
            server.run(kernel.now_ns + 1_000_000)
            continue
        before = time.monotonic()
        server.poll(POLL_S)
        kernel.run(kernel.now_ns + round((time.monotonic() - before) * 1e9))


def _count_frames(kernel: Kernel) -> list[int]:
    count = [0]

    def watch(_end_ns: int, _identifier: int, _data: bytes, _sender: str) -> None:
        count[0] += 1

    kernel.watchers.append(watch)
    return count
