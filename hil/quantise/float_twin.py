"""The joint's control law in float64: nothing rounded, nothing saturated but the current at its limit.

In current counts of the bus d = t_dis_hat / Ktn: d' = g (i - d) - KB w' and i = KJ q"_ref + d, with KA = g T,
KB = g Jn / Ktn and KJ = Jn / Ktn as the physics has them. Its counter wraps as the plant's does.

Ref: the paper's eqs. (5), (6), (8).
"""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from dbc.codec import Codec
from hil.exact_constants import exact_constants
from hil.node import Node
from hil.quantise.signals import Raw
from hil.quantise.tap import COLUMNS, Step, with_own_step
from hil.rig import directly
from hil.scenario import Scenario
from hil.wire.kernel import Kernel
from hil.word_format import WordFormat

Values = npt.NDArray[np.float64]

COUNTER = 1 << 16


@dataclass(frozen=True)
class FloatLaw:
    """The law with its constants; limit: of the current, in counts."""

    ka: float
    kb: float
    kj: float
    limit: float

    @classmethod
    def of(cls, scenario: Scenario, joint: int, codec: Codec) -> "FloatLaw":
        """Return that of joint 1 to n."""
        limit = scenario.joint.limit_A / codec.scale(f"Current_{joint}", "Reference")
        ka, kb, kj = exact_constants(scenario, joint, codec)
        return cls(ka, kb, kj, limit) if scenario.joint.observer else cls(0.0, 0.0, kj, limit)

    @classmethod
    def of_table(cls, form: WordFormat, ka: int, kb: int, kj: int, shift: int, limit: int) -> "FloatLaw":
        """Return that of a parameter table: the same constants as the firmware's, rounded as they are."""
        return cls(ka * 0.5**form.ka_fraction, kb * 0.5**form.kb_places, kj * 0.5 ** form.kj_places(shift), limit)

    def signals(self, count: int, count_prev: int, w_prev: int, d: float, a_ref: float) -> dict[str, tuple[float, ...]]:
        """Return every named signal of one sample; d twice: behind the speed's term, and behind the current's."""
        w = (count - count_prev + COUNTER // 2) % COUNTER - COUNTER // 2
        dw = w - w_prev
        from_speed = self.kb * dw
        estimate = d - from_speed
        feed = self.kj * a_ref
        i = max(-self.limit, min(self.limit, feed + estimate))
        error = i - estimate
        from_current = self.ka * error
        return {
            "count": (count,),
            "w": (w,),
            "dw": (dw,),
            "KB*dw": (from_speed,),
            "d": (estimate, estimate + from_current),
            "estimate": (estimate,),
            "a_ref": (a_ref,),
            "KJ*a_ref": (feed,),
            "i": (i,),
            "i-d": (error,),
            "KA*(i-d)": (from_current,),
        }


def open_loop(law: FloatLaw, samples: Raw) -> dict[str, Values]:
    """Return every signal of a law that hears what the steps heard (rows of COLUMNS), with a d of its own."""
    names = COLUMNS.index("count"), COLUMNS.index("count_prev"), COLUMNS.index("w_prev"), COLUMNS.index("a_ref")
    found: dict[str, list[float]] = {}
    d = 0.0
    for count, count_prev, w_prev, a_ref in samples[:, names].tolist():
        signals = law.signals(count, count_prev, w_prev, d, a_ref)
        d = signals["d"][-1]
        for name, values in signals.items():
            found.setdefault(name, []).extend(values)
    return {name: np.array(values, dtype=np.float64) for name, values in found.items()}


@dataclass
class FloatStep:
    """A joint's step played by its law. A frame holds whole counts: so the current is rounded there, and only there.

    roundings: what that added to each current, in counts; the law goes on with the current that it meant. meant: that.
    """

    law: FloatLaw
    roundings: list[float] = field(default_factory=list)
    meant: float = 0.0

    def __call__(
        self, _words: object, count: int, count_prev: int, w_prev: int, d: float, a_ref: float, *_table: int
    ) -> tuple[int, float, int, int]:
        """Return (w, d, i, estimate) as the firmware's step does, d unrounded."""
        signals = self.law.signals(count, count_prev, w_prev, d, a_ref)
        (i,), (estimate,) = signals["i"], signals["estimate"]
        self.meant = i
        self.roundings.append(round(i) - i)
        shown = max(-0x8000, min(0x7FFF, round(estimate)))
        return int(signals["w"][0]), signals["d"][-1], round(i), shown


class FloatSeats:
    """Lets nodes take part, each joint with its law in float64. steps: by joint."""

    def __init__(self, scenario: Scenario, codec: Codec) -> None:
        self._scenario, self._codec = scenario, codec
        self.steps: dict[int, FloatStep] = {}

    def seat(self, kernel: Kernel, node: Node) -> None:
        """Let a node take part."""
        if node.name.startswith("joint"):
            joint = with_own_step(node)
            self.steps[joint.number] = FloatStep(FloatLaw.of(self._scenario, joint.number, self._codec))
            joint.step = self.step_of(joint.number)
        directly(kernel, node)

    def step_of(self, joint: int) -> Step:
        """Return what plays joint 1 to n."""
        return self.steps[joint]
