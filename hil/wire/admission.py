"""Who may come in: the reasons why a client is refused."""

from collections.abc import Collection, Sequence

from hil.wire.hello import Hello
from hil.wire.kernel import Kernel
from hil.wire.rates import NS_PER_S

CLIENTS = 256
"""On one channel, those included who have left and still send; two descriptors each, 1024 are usual."""


def objection(
    hello: Hello, kernel: Kernel, expect: Sequence[str], names: Collection[str], now_ns: int, started: bool
) -> str | None:
    """Return why this client cannot join this bus now; None if it can."""
    name, timed = hello.name, hello.role == "timed"
    if name in names:
        return f"there is a client of the name {name!r} already: give it another"
    if max(len(names), len(kernel.ports)) >= CLIENTS:
        return f"{CLIENTS} clients are there already"
    if timed and expect and name not in expect:
        return f"time waits for {', '.join(expect)} only: join with timed=False"
    if not timed and name in expect:
        return f"time waits for a timed client of the name {name!r}: take another"
    if started and hello.start_ns is not None and hello.start_ns < now_ns:
        return (
            f"its time begins at {hello.start_ns * 1e-9:.3f} s, but here it is {now_ns * 1e-9:.3f} s already: "
            "a bus that waits for its clients is started with --expect"
        )
    return _rates_objection(hello, kernel)


def _rates_objection(hello: Hello, kernel: Kernel) -> str | None:
    rates = kernel.rates
    if hello.fd and not rates.fd:
        return "it wants CAN FD, but this is a classic bus: start the bus with --data-bitrate, or leave fd out"
    if kernel.functional:
        return None
    for what, wanted, have in (
        ("bitrate", hello.bit_ns, rates.bit_ns),
        ("data_bitrate", hello.data_bit_ns, rates.data_bit_ns),
    ):
        if wanted is not None and wanted != have:
            runs = "has none" if have is None else f"runs at {NS_PER_S // have} bit/s"
            return f"{what} = {NS_PER_S // wanted} bit/s, but the bus {runs}: give the same, or leave it out"
    return None
