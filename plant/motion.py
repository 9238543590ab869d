"""What moves the arm between the robot's events: one seam, two ways to compute the same motion.

`closed`: the closed form with classical Runge-Kutta steps and exact Coulomb friction, the record. `pymunk`: the links
as rigid bodies held together by impulses, which shares no equation with it: to cross-check direct-drive arms.
"""

from typing import Protocol

from plant.drive import Amplifiers
from plant.parameters import Vector
from plant.rigid_body import RigidBody
from plant.stick_slip import StickSlip

BACKENDS = ("closed", "pymunk")


class Motion(Protocol):
    """State q [rad], w [rad/s] of an arm under constant current references, external torque and friction limits."""

    q: Vector
    w: Vector

    def change(
        self, body: RigidBody | None = None, external_Nm: Vector | None = None, friction_limit_Nm: Vector | None = None
    ) -> None:
        """Replace what acts on the arm from now on; speeds stay as they are."""

    def advance(self, span_s: float) -> None:
        """Let span_s pass under the currents of now; q and w follow with `arrive`."""

    def arrive(self) -> None:
        """Bring q, w and `balance` to now."""

    def balance(self) -> tuple[Vector, Vector]:
        """Return (q" [rad/s^2], friction [N m]) at this instant."""

    def prepare(self) -> None:
        """Do now what would otherwise be done at the first use."""


def motion_of(backend: str, body: RigidBody, amplifiers: Amplifiers, q: Vector, longest_step_ns: int) -> Motion:
    """Return the arm at rest at q; ValueError if there is no such backend, or it cannot carry this arm."""
    if backend == "closed":
        return StickSlip(body, amplifiers, q)
    if backend == "pymunk":
        from plant.pymunk_arm import STEP_NS, PymunkArm

        return PymunkArm(body, amplifiers, q, min(longest_step_ns, STEP_NS))
    raise ValueError(f"backend: {backend!r}, but there are {' and '.join(BACKENDS)}: take one of them")
