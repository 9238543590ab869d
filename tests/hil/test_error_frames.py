"""Error frames as candump and its like read them, against the header of Linux itself.

Ref: linux/can/error.h, linux/can.h.
"""

import re
from pathlib import Path

import pytest

from hil.wire import confinement
from hil.wire.duration import plan_of
from hil.wire.events import error_frame
from hil.wire.fault import BitError, Overrun, StuckDominant
from hil.wire.identifier import EXTENDED

HEADER = Path("/usr/include/linux/can/error.h")
ERR_FLAG = 0x20000000
IDENTIFIER, DATA = 0x2AA, b"\x55\x33"


@pytest.fixture(scope="module")
def header():
    """The constants of linux/can/error.h, without their common prefix."""
    if not HEADER.exists():
        pytest.skip(f"{HEADER} is not there: apt-get install linux-libc-dev")
    found = re.findall(r"^#define\s+CAN_(\w+)\s+(0x[0-9A-Fa-f]+|\d+)U?\b", HEADER.read_text(), re.MULTILINE)
    return {name.removeprefix("ERR_"): int(value, 0) for name, value in found}


def flip(bit, *at, identifier=IDENTIFIER, **kwargs):
    return BitError(identifier=identifier, bit=bit, at=at, **kwargs)


def frames_of(bus, name=None):
    """Error frames as they are told, each at its instant."""
    return [frame for _, who, frame in bus.told if name in (None, who)]


@pytest.fixture
def telling(wire):
    """Buses that keep the error frame of each event."""

    def make(names="abc", script=(), **kwargs):
        bus = wire(names, script, **kwargs)
        bus.told = []
        bus.kernel.listeners.append(lambda event: bus.told.append((event.time_ns, event.port.name, error_frame(event))))
        return bus

    return make


def first(bus, name):
    identifier, data = frames_of(bus, name)[0]
    assert identifier & ERR_FLAG
    assert len(data) == 8  # CAN_ERR_DLC
    return identifier & ~ERR_FLAG, data


WHERE = [
    (0, "a", "PROT_BIT", "PROT_LOC_SOF"),
    (3, "a", "PROT_BIT", "PROT_LOC_ID28_21"),
    (9, "a", "PROT_BIT", "PROT_LOC_ID20_18"),
    (12, "a", "PROT_BIT", "PROT_LOC_SRTR"),
    (13, "a", "PROT_BIT", "PROT_LOC_IDE"),
    (14, "a", "PROT_BIT", "PROT_LOC_RES0"),
    (18, "a", "PROT_BIT", "PROT_LOC_DLC"),
    (22, "a", "PROT_BIT", "PROT_LOC_DATA"),
    (38, "a", "PROT_BIT", "PROT_LOC_CRC_SEQ"),
    (45, "b", "PROT_STUFF", "PROT_LOC_CRC_SEQ"),
    (52, "b", "PROT_FORM", "PROT_LOC_CRC_DEL"),
    (54, "b", "PROT_FORM", "PROT_LOC_ACK_DEL"),
    (57, "b", "PROT_FORM", "PROT_LOC_EOF"),
    (22, "b", "PROT_UNSPEC", "PROT_LOC_CRC_SEQ"),  # as Linux drivers tell a CRC error
]


@pytest.mark.parametrize(("bit", "node", "what", "where"), WHERE)
def test_protocol_errors(telling, header, bit, node, what, where):
    bus = telling("abc", [flip(bit, node)]).send("a", IDENTIFIER, DATA).run(70)
    kind, data = first(bus, node)
    assert kind == header["PROT"] | header["BUSERROR"] | header["CNT"]
    assert data[2] == header[what] | (header["PROT_TX"] if node == "a" else 0)
    assert data[3] == header[where]
    assert data[0] == data[1] == data[4] == 0


EXTENDED_WHERE = {
    "PROT_LOC_ID28_21": (1, 9),
    "PROT_LOC_ID20_18": (9, 12),
    "PROT_LOC_SRTR": (12, 13),
    "PROT_LOC_IDE": (13, 14),
    "PROT_LOC_ID17_13": (14, 19),
    "PROT_LOC_ID12_05": (19, 27),
    "PROT_LOC_ID04_00": (27, 32),
    "PROT_LOC_RTR": (32, 33),
    "PROT_LOC_RES1": (33, 34),
    "PROT_LOC_RES0": (34, 35),
}


@pytest.mark.parametrize("where", EXTENDED_WHERE)
def test_places_of_an_extended_frame(telling, header, where):
    """An identifier without stuff bits; dominant bits of it are hit, for the recessive ones lose arbitration."""
    identifier = 0x0AAAAAAA | EXTENDED
    plan = plan_of(identifier, DATA)
    assert not any(plan.stuff[:35])
    bit = next((bit for bit in range(*EXTENDED_WHERE[where]) if plan.levels[bit] == 0), None)
    if bit is None:
        assert where in ("PROT_LOC_SRTR", "PROT_LOC_IDE")  # recessive: to see them dominant is to lose arbitration
        return
    bus = telling("abc", [flip(bit, "a", identifier=identifier)]).send("a", identifier, DATA).run(70)
    assert first(bus, "a")[1][3] == header[where]


def test_missing_acknowledgement(telling, header):
    bus = telling("a").send("a", IDENTIFIER, DATA).run(60)
    kind, data = first(bus, "a")
    assert kind == header["ACK"] | header["BUSERROR"] | header["CNT"]
    assert data[3] == header["PROT_LOC_ACK"]
    assert (data[6], data[7]) == (8, 0)


def test_overload(telling, header):
    bus = telling("abc", [flip(-1, "b")]).send("a", IDENTIFIER, DATA).run(70)
    kind, data = first(bus, "b")
    assert kind & header["PROT"]
    assert data[2] & header["PROT_OVERLOAD"]


def test_error_in_intermission_and_flags_has_a_place(telling, header):
    bus = telling("abcd", [StuckDominant(node="d", from_s=62e-6, to_s=63e-6)]).send("a", IDENTIFIER, DATA).run(100)
    assert first(bus, "a")[1][3] == header["PROT_LOC_INTERM"]


def test_lost_arbitration(telling, header):
    """Bit 11 of 0x2AA, its last, counted from SOF; 0 would be unspecified."""
    bus = telling().set("a", discards=True).send("a", 0x2AB, DATA).send("b", IDENTIFIER, DATA).run(70)
    kind, data = first(bus, "a")
    assert kind == header["LOSTARB"] | header["CNT"]
    assert data[0] == 11 != header["LOSTARB_UNSPEC"]


def test_receive_overrun(telling, header):
    bus = telling("ab", [Overrun(node="b", from_s=0)]).send("a", IDENTIFIER, DATA).run(70)
    kind, data = first(bus, "b")
    assert kind == header["CRTL"] | header["CNT"]
    assert data[1] == header["CRTL_RX_OVERFLOW"]


@pytest.mark.parametrize(
    ("node", "tec", "rec", "status"),
    [("a", header_limit - 8, 0, f"CRTL_TX_{name}") for header_limit, name in ((96, "WARNING"), (128, "PASSIVE"))]
    + [("b", 0, header_limit - 1, f"CRTL_RX_{name}") for header_limit, name in ((96, "WARNING"), (128, "PASSIVE"))],
)
def test_limits_of_the_counters(telling, header, node, tec, rec, status):
    bus = telling("abc", [flip(22, "a")]).set(node, tec=tec, rec=rec).send("a", IDENTIFIER, DATA).run(40)
    kind, data = frames_of(bus, node)[1]
    assert kind & ~ERR_FLAG == header["CRTL"] | header["CNT"]
    assert data[1] == header[status]
    assert (data[6], data[7]) == (tec + 8 * (node == "a"), rec + (node == "b"))


def test_limits_are_those_of_the_header(header):
    assert header["ERROR_WARNING_THRESHOLD"] == confinement.WARNING_LIMIT
    assert header["ERROR_PASSIVE_THRESHOLD"] == confinement.PASSIVE_LIMIT
    assert header["BUS_OFF_THRESHOLD"] == confinement.OFF_LIMIT


def test_back_to_active(telling, header):
    bus = telling("abc").set("a", tec=96).send("a", IDENTIFIER, DATA).run(70)
    kind, data = frames_of(bus, "a")[-1]
    assert kind & header["CRTL"]
    assert data[1] == header["CRTL_ACTIVE"]


def test_bus_off_and_back(telling, header):
    bus = telling("abc", [flip(22, "a")]).set("a", tec=248).send("a", IDENTIFIER, DATA).run(3000)
    kinds = [kind & ~ERR_FLAG for kind, _ in frames_of(bus, "a")]
    assert kinds == [
        header["PROT"] | header["BUSERROR"] | header["CNT"],
        header["BUSOFF"] | header["CNT"],
        header["RESTARTED"] | header["CNT"],
    ]
    _, data = frames_of(bus, "a")[1]
    assert data[6] == 255  # the counter does not fit


def test_counters_are_those_of_the_node(telling):
    bus = telling("abc", [flip(16, "b")]).set("c", tec=7, rec=30).send("a", IDENTIFIER, DATA).run(39)
    assert first(bus, "c")[1][6:] == bytes([7, 31])
    assert first(bus, "a")[1][6:] == bytes([8, 0])
