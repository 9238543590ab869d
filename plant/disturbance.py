"""The disturbance torque of a recorded run, term by term, from the plant's own truth.

Units: SI, arrays (K, n) of K recorded instants. Ref: eqs. (3) and (4).
"""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from plant.array_form import Array, coriolis, gravity, inertia, payload_rows
from plant.parameters import ArmParameters, Vector


@dataclass(frozen=True)
class DisturbanceTerms:
    """The terms of eq. (4) [N m], each (K, n)."""

    inertia_variation: Array  # (M(q) - Jn) q"
    coriolis: Array  # h
    gravity: Array  # g
    viscous: Array  # D q'
    friction: Array  # c, brakes included
    reaction: Array  # r, minus the torque from outside
    ripple: Array  # (Ktn - Kt(q)) i_a

    def total(self) -> Array:
        """Return their sum t_dis, which is Ktn i_a - Jn q" by eq. (3)."""
        total: Array = np.sum([getattr(self, field.name) for field in fields(self)], axis=0)
        return total


def disturbance_terms(
    parameters: ArmParameters,
    q: Array,
    w: Array,
    acceleration: Array,
    current_A: Array,
    friction_Nm: Array,
    Jn: Vector,
    Ktn: Vector,
    payload_kg: float | Array = 0.0,
    external_Nm: Array | None = None,
) -> DisturbanceTerms:
    """Return the terms of eq. (4) for recorded (K, n) arrays, payload_kg one number or (K,).

    ValueError if shapes differ, or a payload is negative or not finite.
    """
    external = np.zeros_like(q) if external_Nm is None else external_Nm
    recorded = {"q": q, "w": w, "acceleration": acceleration, "current_A": current_A, "friction_Nm": friction_Nm}
    _check_shapes({**recorded, "external_Nm": external}, parameters.joints)
    payload = payload_rows(payload_kg, len(q))
    variation = inertia(parameters, q, payload) - np.diag(Jn)
    ripple = np.array(parameters.ripple) * np.cos(np.array(parameters.ripple_order) * q)
    Kt = np.array(parameters.torque_constant_Nm_A) * (1 + ripple)
    return DisturbanceTerms(
        inertia_variation=(variation @ acceleration[:, :, None])[:, :, 0],
        coriolis=coriolis(parameters, q, w, payload),
        gravity=gravity(parameters, q, payload),
        viscous=np.array(parameters.viscosity_Nms) * w,
        friction=friction_Nm,
        reaction=-external,
        ripple=(np.array(Ktn) - Kt) * current_A,
    )


def _check_shapes(arrays: dict[str, Any], joints: int) -> None:
    rows = len(arrays["q"])
    for name, array in arrays.items():
        if np.shape(array) != (rows, joints):
            raise ValueError(f"{name}: shape {np.shape(array)}, but q has {rows} rows and the arm {joints} joints")
