"""Other people's protocol stacks on interface `hil`, unchanged, both ends on one bus: can-isotp and canopen."""

import random
import threading
from contextlib import ExitStack

import can
import canopen
import isotp
import pytest
from canopen.objectdictionary import UNSIGNED8, UNSIGNED16, UNSIGNED32, VISIBLE_STRING, ODArray, ODRecord, ODVariable

pytestmark = pytest.mark.usefixtures("bounded")

GUARD_S = 10

# -- can-isotp --

KIBIBYTES_4 = random.Random(15765).randbytes(4096)


@pytest.fixture
def stack(hil):
    """Open stacks, reading by a notifier or by themselves; what they have to complain of is kept for the test."""
    hil.bus("arm", "--bitrate", "500000")
    with ExitStack() as behind:

        def make(here, there, notified, **parameters):
            bus = behind.enter_context(can.Bus(interface="hil", channel="arm", bitrate=500_000))
            address = isotp.Address(isotp.AddressingMode.Normal_11bits, rxid=here, txid=there)
            errors = []
            kwargs = {"address": address, "error_handler": errors.append, "params": parameters}
            if notified:
                notifier = behind.enter_context(can.Notifier(bus, [], timeout=0.05))
                made = isotp.NotifierBasedCanStack(bus, notifier, **kwargs)
            else:
                made = isotp.CanStack(bus, **kwargs)
            made.errors = errors
            made.start()
            behind.callback(made.stop)
            return made

        yield make


def test_isotp_carries_4_kib_both_ways(stack):
    """About 590 frames each way, a flow control for every eighth."""
    tester = stack(0x7E8, 0x7E0, True, max_frame_size=4096)
    device = stack(0x7E0, 0x7E8, False, max_frame_size=4096)
    tester.send(KIBIBYTES_4)
    assert device.recv(block=True, timeout=GUARD_S) == KIBIBYTES_4
    device.send(KIBIBYTES_4[::-1])
    assert tester.recv(block=True, timeout=GUARD_S) == KIBIBYTES_4[::-1]
    assert tester.errors == device.errors == []


def test_isotp_carries_both_ways_at_once(stack):
    parameters = {"blocking_send": True, "stmin": 1}
    ends = stack(0x7E8, 0x7E0, True, **parameters), stack(0x7E0, 0x7E8, True, **parameters)
    sending = [threading.Thread(target=end.send, args=(KIBIBYTES_4[:256], None, GUARD_S)) for end in ends]
    for thread in sending:
        thread.start()
    assert [end.recv(block=True, timeout=GUARD_S) for end in ends] == [KIBIBYTES_4[:256]] * 2
    for thread in sending:
        thread.join()
    assert [end.errors for end in ends] == [[], []]


# -- canopen --

NODE = 5
TEXT = "a text that is longer than the four bytes of an expedited transfer"
SPEED, POSITION, NAME, HEARTBEAT = 0x2000, 0x2001, 0x2002, 0x1017


def variable(name, index, subindex, kind, default, mappable=False):
    made = ODVariable(name, index, subindex)
    made.data_type, made.default, made.access_type, made.pdo_mappable = kind, default, "rw", mappable
    return made


def group(kind, name, index, *values):
    """An array or record with these (data type, default) from subindex 0 on."""
    made = kind(name, index)
    for subindex, (data_type, default) in enumerate(values):
        made.add_member(variable(f"{name} {subindex}", index, subindex, data_type, default))
    return made


def dictionary():
    """Two variables, a text, and the PDOs that carry them: TPDO1 the position, RPDO1 the speed."""
    made = canopen.ObjectDictionary()
    made.add_object(variable("Heartbeat", HEARTBEAT, 0, UNSIGNED16, 0))
    made.add_object(variable("Speed", SPEED, 0, UNSIGNED16, 0, mappable=True))
    made.add_object(variable("Position", POSITION, 0, UNSIGNED32, 0, mappable=True))
    made.add_object(variable("Name", NAME, 0, VISIBLE_STRING, TEXT))
    for communication, mapping, cob_id, mapped in (
        (0x1400, 0x1600, 0x200 + NODE, SPEED << 16 | 16),
        (0x1800, 0x1A00, 0x180 + NODE, POSITION << 16 | 32),
    ):
        made.add_object(
            group(
                ODRecord, f"PDO {communication:X}", communication, (UNSIGNED8, 2), (UNSIGNED32, cob_id), (UNSIGNED8, 1)
            )
        )
        made.add_object(group(ODArray, f"Map {mapping:X}", mapping, (UNSIGNED8, 1), (UNSIGNED32, mapped)))
    return made


@pytest.fixture
def nodes(hil):
    """A master's view of a node, and the node, each with a bus of its own."""
    hil.bus("arm", "--bitrate", "500000")
    master, device = canopen.Network(), canopen.Network()
    remote, local = canopen.RemoteNode(NODE, dictionary()), canopen.LocalNode(NODE, dictionary())
    for network, node in ((master, remote), (device, local)):
        network.NOTIFIER_CYCLE = 0.05
        network.connect(interface="hil", channel="arm", bitrate=500_000)
        network.add_node(node)
    remote.sdo.RESPONSE_TIMEOUT = GUARD_S
    for node in (local, remote):
        node.tpdo.read()
        node.rpdo.read()
    yield remote, local
    for network in (master, device):
        network.disconnect()


def test_canopen_sdo_uploads_and_downloads(nodes):
    """Expedited and segmented, read and written, and an abort for what is not there."""
    remote, local = nodes
    assert remote.sdo["Speed"].raw == 0
    remote.sdo["Speed"].raw = 1234
    assert local.sdo["Speed"].raw == 1234
    assert remote.sdo["Name"].raw == TEXT
    remote.sdo["Name"].raw = TEXT[::-1]
    assert local.sdo["Name"].raw == remote.sdo["Name"].raw == TEXT[::-1]
    with pytest.raises(canopen.SdoAbortedError):
        remote.sdo.upload(0x3000, 0)


def test_canopen_pdos_go_both_ways(nodes):
    remote, local = nodes
    told = threading.Event()
    local.rpdo[1].add_callback(lambda _: told.set())
    remote.rpdo[1]["Speed"].raw = 500
    remote.rpdo[1].transmit()
    assert told.wait(GUARD_S)
    assert local.rpdo[1]["Speed"].raw == 500

    heard = []
    full = threading.Event()
    remote.tpdo[1].add_callback(lambda message: (heard.append(message["Position"].raw), len(heard) > 4 and full.set()))
    local.tpdo[1]["Position"].raw = 1
    local.tpdo[1].start(0.01)
    while not heard:
        remote.tpdo[1].wait_for_reception(0.1)
    local.tpdo[1]["Position"].raw = 0x12345678
    local.tpdo[1].update()
    assert full.wait(GUARD_S)
    while heard[-1] != 0x12345678:
        remote.tpdo[1].wait_for_reception(0.1)
    assert set(heard) == {1, 0x12345678}
    local.tpdo[1].stop()


def test_canopen_device_answers_every_sync(nodes):
    """The SYNCs are a periodic task of the master's bus; the device tells its position at each."""
    remote, local = nodes
    heard, full = [], threading.Event()

    def on_sync(*_):
        local.tpdo[1]["Position"].raw = local.tpdo[1]["Position"].raw + 1
        local.tpdo[1].transmit()

    def on_position(message):
        heard.append(message["Position"].raw)
        if len(heard) == 10:
            full.set()

    local.network.subscribe(0x80, on_sync)
    remote.tpdo[1].add_callback(on_position)
    remote.network.sync.start(0.02)
    assert full.wait(GUARD_S)
    remote.network.sync.stop()
    assert heard[:10] == list(range(1, 11))


def test_canopen_network_management_and_heartbeat(nodes):
    remote, local = nodes
    local.nmt.state = "PRE-OPERATIONAL"
    remote.sdo[HEARTBEAT].raw = 20
    assert remote.nmt.wait_for_heartbeat(GUARD_S) == "PRE-OPERATIONAL"
    remote.nmt.state = "OPERATIONAL"
    for _ in range(100):
        if remote.nmt.wait_for_heartbeat(GUARD_S) == "OPERATIONAL" == local.nmt.state:
            break
    assert local.nmt.state == "OPERATIONAL"
    remote.sdo[HEARTBEAT].raw = 0
