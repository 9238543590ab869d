"""From physical units to the integers of the joint CPU, and the time that a cycle's frames need.

Ref: the paper's eqs. (5), (6), (8), with KA = g T in Q15, KB = g Jn / Ktn in current counts per count and sample,
KJ = Jn / Ktn in current counts per acceleration count.
"""

from dbc.codec import Codec
from firmware_py.dsp.cpu import ACCEL_REFS, JOINTS_A_FRAME
from hil.errors import ScenarioError
from hil.exact_constants import exact_constants
from hil.scenario import Scenario
from hil.scenario_parts import to_ns
from hil.wire.bits import INTERMISSION_BITS, worst_case_bits
from hil.word_format import BUS_BITS, WordFormat, raw

CURRENT_FORMAT = "joint.word.current_fraction"
CURES = {
    "KA": "change joint.g_rad_s or clock.period_s",
    "KB": "change joint.g_rad_s, joint.inertia_kg_m2 or encoder.counts_per_turn",
    "KJ": "change joint.inertia_kg_m2 or joint.torque_constant_N_m_A",
    "current limit": "change joint.limit_A",
}
STOP_REASONS = {
    0: "end",
    1: "operator",
    2: "joint fault",
    3: "joint not ready",
    4: "singular reference",
    5: "out of reach",
    6: "encoder lost",
    7: "saturated reference",
    8: "current lost",
}
"""Of Stop, as in arm.dbc."""
STOP_OPERATOR = 1
LARGEST_SHIFT = 15
BUS, COMPUTING, DRIVE, HOST = "bus", "computing", "drive", "host"
"""Causes of a current that does not act by its deadline: the bus; a node's CPU; the dead time; this machine."""
BY_TURNS = ("State", "Heartbeat")
"""Frames of many senders that share one slot of a cycle."""
STATUS_MARGIN_BITS = 25
TAIL_BITS = worst_case_bits(8) + INTERMISSION_BITS + STATUS_MARGIN_BITS
"""State and Heartbeat are queued so long before the end of their cycle: the longest frame, and a margin."""


def parameter_table(scenario: Scenario, joint: int, codec: Codec) -> tuple[int, ...]:
    """Return KA, KB, KJ, shift and current limit of joint 1 to n; raise ScenarioError where one does not fit."""
    settings, period_s = scenario.joint, scenario.clock.period_s
    exact_ka, exact_kb, exact_kj = exact_constants(scenario, joint, codec)
    if exact_ka >= 1.0:
        raise ScenarioError(
            f"joint.g_rad_s = {settings.g_rad_s} with clock.period_s = {period_s}: g T = {exact_ka:.3f} must stay "
            f"below 1; lower g below {1.0 / period_s:.0f} rad/s or shorten the period"
        )
    form = WordFormat.of(scenario, codec)
    own_kb, own_kj = (
        exact_kb * 2.0**form.current_shift,
        exact_kj * 2.0 ** (form.current_shift - form.acceleration_shift),
    )
    shift = next((s for s in range(LARGEST_SHIFT, -1, -1) if round(own_kj * 2.0**s) <= form.largest_constant), 0)
    bits = form.constant_bits
    ka = raw(f"joint{joint}: KA", exact_ka, form.ka_fraction, bits, CURES["KA"])
    kb = raw(f"joint{joint}: KB", own_kb, form.kb_fraction, bits, CURES["KB"], "joint.word.kb_fraction")
    kj = raw(f"joint{joint}: KJ", own_kj, shift, bits, CURES["KJ"])
    limit = raw(f"joint{joint}: current limit", settings.limit_A, form.bus_current, BUS_BITS, CURES["current limit"])
    raw(
        f"joint{joint}: current limit",
        settings.limit_A,
        form.current,
        form.bits,
        CURES["current limit"],
        CURRENT_FORMAT,
    )
    if not settings.observer:
        ka = kb = 0
    return ka, kb, kj, shift, limit


def constants_fit(scenario: Scenario, codec: Codec) -> bool:
    """Return whether the parameters of all joints fit their formats."""
    try:
        for joint in range(1, scenario.joints + 1):
            parameter_table(scenario, joint, codec)
    except ScenarioError:
        return False
    return True


def cycle_frames(joints: int) -> dict[str, int]:
    """Return the frames of one cycle in the order of the bus, with their data lengths."""
    frames = {"Sync": 1}
    frames |= {f"Encoder_{n}": 4 for n in range(1, joints + 1)}
    frames |= {f"Current_{n}": 6 for n in range(1, joints + 1)}
    frames |= dict.fromkeys(ACCEL_REFS[: -(-joints // JOINTS_A_FRAME)], 8)
    return frames | {"State": 8}


def worst_case_ends_ns(scenario: Scenario) -> dict[str, int]:
    """Return the latest end of each frame of a cycle after its start, each queued when its sender has computed.

    The Current of a joint by its own timer may come at any time: its bits count here, but no end of it is promised, nor
    that it holds up no other frame, once a period and by its own length.
    """
    ends: dict[str, int] = {}
    free_ns = 0
    for name, length in cycle_frames(scenario.joints).items():
        start_ns = max(free_ns, _queued_ns(scenario, name, ends))
        ends[name] = start_ns + worst_case_bits(length) * scenario.bit_ns
        free_ns = ends[name] + INTERMISSION_BITS * scenario.bit_ns
    return ends


def _queued_ns(scenario: Scenario, name: str, ends: dict[str, int]) -> int:
    """Return when a frame is queued at the latest, from the frame that its sender answers."""
    if name.startswith("Current_"):
        joint = int(name.removeprefix("Current_"))
        if scenario.crystal_ppb(joint) is not None:
            return 0
        return ends[f"Encoder_{joint}"] + scenario.compute_ns(joint)
    if name in ACCEL_REFS:
        return ends[f"Encoder_{scenario.joints}"] + to_ns(scenario.dsp.compute_s)
    return 0


def action_delays_ns(scenario: Scenario) -> tuple[int, ...]:
    """Return when each joint's current acts after its cycle's start; 0 in `bits`, where its frame's end says it."""
    if scenario.bus.fidelity == "bits":
        return (0,) * scenario.joints
    ends = worst_case_ends_ns(scenario)
    delays = tuple(ends[f"Current_{n}"] for n in range(1, scenario.joints + 1))
    if scenario.bus.action_delay_s is not None:
        delays = tuple(to_ns(delay) for delay in scenario.bus.action_delay_s)
    if max(delays) >= scenario.period_ns:
        raise ScenarioError(
            f"bus.action_delay_s: a current would act {max(delays) / 1000:.0f} us after its cycle's start, but "
            f"clock.period_s = {scenario.clock.period_s}: give delays below it"
        )
    return delays


def tail_ns(scenario: Scenario) -> int:
    """Return how long before the end of its cycle a State or Heartbeat is queued: 160 us at 1 Mbit/s."""
    return TAIL_BITS * scenario.bit_ns


def cycle_ns(scenario: Scenario) -> int:
    """Return the shortest period into which the frames of a cycle fit, each queued when its sender has computed."""
    return worst_case_ends_ns(scenario)["State"] + INTERMISSION_BITS * scenario.bit_ns


def check_budget(scenario: Scenario) -> None:
    """Refuse a cycle whose frames do not fit its period."""
    end_ns = cycle_ns(scenario)
    if scenario.bus.fidelity == "bits" and end_ns > scenario.period_ns:
        raise ScenarioError(
            f"the frames of one cycle need {end_ns / 1000:.0f} us at bus.bitrate = {scenario.bus.bitrate} and with the "
            f"computing times, but clock.period_s = {scenario.clock.period_s} leaves "
            f"{scenario.period_ns / 1000:.0f} us: raise the bit rate or the period, or compute faster (clock_hz, "
            f"compute_s); {_bits_sum(scenario.joints)}; the rest is waiting for what is computed"
        )


def _bits_sum(joints: int) -> str:
    """Return the longest frames of a cycle by kind, with intermission, and their sum."""
    bits: dict[str, list[int]] = {}
    for name, length in cycle_frames(joints).items():
        bits.setdefault(name.partition("_")[0], []).append(worst_case_bits(length) + INTERMISSION_BITS)
    parts = [f"{len(each)} x {each[0]} {name}" if len(each) > 1 else f"{each[0]} {name}" for name, each in bits.items()]
    return f"{' + '.join(parts)} = {sum(map(sum, bits.values()))} bits"
