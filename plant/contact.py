"""What a compliant surface does to the arm's tip: source text of its force, for every stage of a Runge-Kutta step.

A surface is a plane that moves with constant velocity during a substep. A spring and a damper along its outward normal
push and never pull; Coulomb friction acts along it, proportional to the slip below the sliding speed:

    F_n = max(0, K depth - C rate) where depth > 0        F_t = -mu F_n slip / max(|slip|, sliding speed)

rate being the tip's speed away from the plane, slip its speed along the tangent (the normal turned left by 90 degrees).
Units: SI. Ref: r(q, f) of eqs. (1) and (4); Kelvin-Voigt contact.
Not modelled: sticking of the tip (below the sliding speed it creeps), contact of the links, a plane's own rotation
within a substep.
"""

from dataclasses import dataclass, fields
from math import isfinite
from typing import NamedTuple

Lines = list[str]


@dataclass(frozen=True)
class Compliance:
    """How a surface gives way to the tip; ValueError names what is wrong with it."""

    stiffness_N_m: float
    damping_N_s_m: float = 0.0
    friction: float = 0.0  # Coulomb coefficient against the tip
    sliding_speed_m_s: float = 1e-3  # from here on friction is all of mu F_n

    def __post_init__(self) -> None:
        for field in fields(self):
            value, may_vanish = getattr(self, field.name), field.name in ("damping_N_s_m", "friction")
            if not isfinite(value) or value < 0.0 or (value == 0.0 and not may_vanish):
                least = "at least" if may_vanish else "more than"
                raise ValueError(f"{field.name}: {value}, but it must be {least} 0 and finite: correct the surface")


class Surface(NamedTuple):
    """A plane near the tip at an instant: a point of it, its unit normal outwards, its velocity, and how it gives."""

    x_m: float
    y_m: float
    normal_x: float
    normal_y: float
    speed_x_m_s: float
    speed_y_m_s: float
    stiffness_N_m: float
    damping_N_s_m: float
    friction: float
    sliding_speed_m_s: float
    mobility_1_kg: float
    """Acceleration that 1 N gives it at most: 0 of a wall."""

    def after(self, span_s: float) -> "Surface":
        """Return where it is span_s later."""
        if self.speed_x_m_s == self.speed_y_m_s == 0.0:
            return self
        return self._replace(
            x_m=self.x_m + self.speed_x_m_s * span_s,
            y_m=self.y_m + self.speed_y_m_s * span_s,
        )


class Touch(NamedTuple):
    """How the tip meets one surface: depth, and the force on the tip along its normal and its tangent."""

    depth_m: float
    normal_N: float
    tangential_N: float


NOT_TOUCHING = Touch(0.0, 0.0, 0.0)
_PLANE = "px, py, nx, ny, ux, uy, stiffness, damping, friction, sliding, _ = surfaces[{k}]"


def contact_lines(n: int, joints: tuple[int, ...], surfaces: int, since: str) -> Lines:
    """Add to f_i of these joints the torque of the contact, `since` (a name, "" for 0) after the surfaces were there.

    Needs q_i, w_i and the links' lengths l_i; leaves gap, push and rub (F_n, F_t) of every surface.
    """
    if surfaces == 0:
        return []
    lines = [*_tip_lines(n), "force_x = force_y = 0.0"]
    for k in range(surfaces):
        lines += _force_lines(k, since)
    return lines + [f"f{i} = f{i} + (arm_x{i} * force_y - arm_y{i} * force_x)" for i in joints]


def _tip_lines(n: int) -> Lines:
    """Set (arm_x_i, arm_y_i), from joint i to the tip, and the tip's velocity; joint 1 is the origin."""
    lines = [f"theta{i} = {f'theta{i - 1} + q{i}' if i > 1 else 'q1'}" for i in range(1, n + 1)]
    for i in range(n, 0, -1):
        for axis, function in (("x", "cos"), ("y", "sin")):
            beyond = f"arm_{axis}{i + 1} + " if i < n else ""
            lines.append(f"arm_{axis}{i} = {beyond}l{i} * {function}(theta{i})")
    lines.append("tip_vx = -(" + " + ".join(f"w{i} * arm_y{i}" for i in range(1, n + 1)) + ")")
    lines.append("tip_vy = " + " + ".join(f"w{i} * arm_x{i}" for i in range(1, n + 1)))
    return lines


def _force_lines(k: int, since: str) -> Lines:
    x, y = (f"(p{axis} + u{axis} * {since})" if since else f"p{axis}" for axis in "xy")
    return [
        _PLANE.format(k=k),
        f"gap{k} = nx * (arm_x1 - {x}) + ny * (arm_y1 - {y})",
        f"push{k} = rub{k} = 0.0",
        f"if gap{k} < 0.0:",
        f"    push{k} = max(0.0, -stiffness * gap{k} - damping * (nx * (tip_vx - ux) + ny * (tip_vy - uy)))",
        "    slip = nx * (tip_vy - uy) - ny * (tip_vx - ux)",
        f"    rub{k} = -friction * push{k} * slip / max(abs(slip), sliding)",
        f"    force_x = force_x + nx * push{k} - ny * rub{k}",
        f"    force_y = force_y + ny * push{k} + nx * rub{k}",
    ]
