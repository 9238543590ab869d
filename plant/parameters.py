"""What the arm is made of: one frozen, validated value, and the default arm.

Units: m, kg, kg m^2, N m, A, s, ns; one tuple entry a joint, joint 1 first; motors are given as seen at the joint.
Ref: eq. (1); the default arm is ours, since the paper gives no masses and no lengths.
Not modelled: links other than uniform rods, gear elasticity and backlash, joint limits.
"""

from dataclasses import dataclass, fields
from math import inf, isfinite

Vector = tuple[float, ...]
"""One float a joint."""

MAX_JOINTS = 6

_PER_JOINT = {  # name: (smallest, whether the smallest itself is allowed, below)
    "length_m": (0.0, False, inf),
    "mass_kg": (0.0, False, inf),
    "rotor_inertia_kgm2": (0.0, True, inf),
    "viscosity_Nms": (0.0, True, inf),
    "coulomb_Nm": (0.0, True, inf),
    "torque_constant_Nm_A": (0.0, False, inf),
    "brake_torque_Nm": (0.0, True, inf),
    "ripple": (0.0, True, 1.0),
    "ripple_order": (0.0, True, inf),
}
_COMMON = {
    "counts_per_turn": (0.0, False, inf),
    "counter_bits": (1.0, True, 65.0),
    "current_limit_A": (0.0, False, inf),
    "current_counts_per_A": (0.0, False, inf),
    "amplifier_lag_s": (0.0, True, inf),
    "brake_delay_ns": (0.0, True, inf),
    "gravity_m_s2": (0.0, True, inf),
}
_WHOLE = ("counts_per_turn", "counter_bits", "current_counts_per_A", "brake_delay_ns")


@dataclass(frozen=True)
class ArmParameters:
    """A planar serial arm of 1 to 6 joints in the vertical plane; ValueError names what is wrong with it."""

    length_m: Vector
    mass_kg: Vector
    rotor_inertia_kgm2: Vector  # N^2 Jm
    viscosity_Nms: Vector
    coulomb_Nm: Vector  # static = kinetic
    torque_constant_Nm_A: Vector  # N Ktn
    brake_torque_Nm: Vector  # friction that an engaged brake adds
    ripple: Vector = ()  # Kt(q) = Ktn (1 + ripple cos(ripple_order q)); () is none
    ripple_order: Vector = ()
    counts_per_turn: int = 819_200  # of the joint
    counter_bits: int = 16
    current_limit_A: float = 8.0
    current_counts_per_A: int = 2048
    amplifier_lag_s: float = 0.0  # 0: a current reference is the current at once
    brake_delay_ns: int = 30_000_000  # from the command to the torque; release is immediate
    gravity_m_s2: float = 9.80665  # along -y

    def __post_init__(self) -> None:
        joints = len(self.length_m)
        if not 1 <= joints <= MAX_JOINTS:
            raise ValueError(f"length_m: {joints} joints, but the arm has 1 to {MAX_JOINTS}: give one length a joint")
        for name in ("ripple", "ripple_order"):
            if len(getattr(self, name)) == 0:
                object.__setattr__(self, name, (0.0,) * joints)
        for field in fields(self):
            self._validate(field.name, joints)

    def _validate(self, name: str, joints: int) -> None:
        if name in _COMMON:
            _check_number(name, getattr(self, name), _COMMON[name])
            return
        values = tuple(getattr(self, name))
        object.__setattr__(self, name, values)
        if len(values) != joints:
            raise ValueError(f"{name}: {len(values)} values for {joints} joints: give one a joint")
        for joint, value in enumerate(values, start=1):
            _check_number(f"{name} of joint {joint}", value, _PER_JOINT[name])

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.length_m)


def check_payload(mass_kg: float) -> float:
    """Return mass_kg if it can be held as a point mass at the tip; ValueError if negative or not finite."""
    _check_number("payload mass_kg", mass_kg, (0.0, True, inf))
    return mass_kg


def _check_number(name: str, value: float, limits: tuple[float, bool, float]) -> None:
    smallest, allowed, below = limits
    if name in _WHOLE and isfinite(value) and value != int(value):
        raise ValueError(f"{name}: {value} is not a whole number: round it")
    if not isfinite(value) or value < smallest or (value == smallest and not allowed) or value >= below:
        lower = f"{'at least' if allowed else 'more than'} {smallest:g}"
        upper = "finite" if below == inf else f"less than {below:g}"
        raise ValueError(f"{name}: {value}, but it must be {lower} and {upper}: correct the arm's parameters")


DEFAULT_ARM = ArmParameters(
    length_m=(0.30, 0.25, 0.15),
    mass_kg=(3.0, 1.5, 0.5),
    rotor_inertia_kgm2=(1.2, 0.5, 0.08),
    viscosity_Nms=(2.0, 1.0, 0.2),
    coulomb_Nm=(4.0, 2.0, 0.4),
    torque_constant_Nm_A=(10.0, 6.0, 2.0),
    # 3 kg at the tip of the outstretched arm need 34.3 / 15.2 / 4.8 N m (tests/plant/test_brake.py)
    brake_torque_Nm=(60.0, 30.0, 8.0),
)
