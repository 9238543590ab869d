"""The arm's M, h, g and its hand over arrays of recorded states, for evaluation after a run.

Units: SI; arrays (K, n) and (K, n, n) for K states. Ref: eq. (1); `closed_form` for the symbols.
Written on its own, not from the same text, so that the identity of eqs. (3) and (4) compares two derivations.
"""

import numpy as np
from numpy.typing import NDArray

from plant.parameters import ArmParameters, check_payload

Array = NDArray[np.float64]


def inertia(parameters: ArmParameters, q: Array, payload_kg: Array) -> Array:
    """Return M (K, n, n), rotors included, at q (K, n) with point masses payload_kg (K,) at the tip."""
    theta = np.cumsum(q, axis=1)
    link = _coupling(parameters, payload_kg) * np.cos(theta[:, :, None] - theta[:, None, :])
    return _outwards(_outwards(link, 2), 1) + np.diag(parameters.rotor_inertia_kgm2)


def coriolis(parameters: ArmParameters, q: Array, w: Array, payload_kg: Array) -> Array:
    """Return h (K, n) at q, w (K, n) with point masses payload_kg (K,) at the tip."""
    theta, speed = np.cumsum(q, axis=1), np.cumsum(w, axis=1)
    link = _coupling(parameters, payload_kg) * np.sin(theta[:, :, None] - theta[:, None, :])
    return _outwards((link @ (speed**2)[:, :, None])[:, :, 0], 1)


def gravity(parameters: ArmParameters, q: Array, payload_kg: Array) -> Array:
    """Return g (K, n) at q (K, n) with point masses payload_kg (K,) at the tip."""
    moment = parameters.gravity_m_s2 * _first_moment(parameters, payload_kg)
    return _outwards(moment * np.cos(np.cumsum(q, axis=1)), 1)


def payload_rows(payload_kg: float | Array, rows: int) -> Array:
    """Return one payload a row; ValueError if one is negative or not finite, or if their number does not fit."""
    values = np.asarray(payload_kg, dtype=float)
    if values.ndim and values.shape != (rows,):
        raise ValueError(f"payload_kg: shape {values.shape} for {rows} recorded rows: give one mass, or one a row")
    for extreme in (values.min(initial=0.0), values.max(initial=0.0)):
        check_payload(float(extreme))
    return np.broadcast_to(values, (rows,))


def _beyond(parameters: ArmParameters, payload_kg: Array) -> Array:
    """Return the mass beyond each link (K, n)."""
    masses = np.array(parameters.mass_kg)
    beyond: Array = np.cumsum(masses[::-1])[::-1] - masses + payload_kg[:, None]
    return beyond


def _first_moment(parameters: ArmParameters, payload_kg: Array) -> Array:
    moment: Array = (np.array(parameters.mass_kg) / 2 + _beyond(parameters, payload_kg)) * np.array(parameters.length_m)
    return moment


def _coupling(parameters: ArmParameters, payload_kg: Array) -> Array:
    """Return A_ij (K, n, n)."""
    length = np.array(parameters.length_m)
    of_outer = _first_moment(parameters, payload_kg)[:, None, :] * length[:, None]
    joint = np.arange(parameters.joints)
    coupling: Array = np.where(joint[:, None] < joint, of_outer, np.swapaxes(of_outer, 1, 2))
    # on the diagonal: m l^2 / 4 + m l^2 / 12 of a uniform rod
    coupling[:, joint, joint] = (np.array(parameters.mass_kg) / 3 + _beyond(parameters, payload_kg)) * length**2
    return coupling


def _outwards(values: Array, axis: int) -> Array:
    """Return the sums over all links from each joint on."""
    outwards: Array = np.flip(np.cumsum(np.flip(values, axis), axis), axis)
    return outwards


def tips(parameters: ArmParameters, q: Array) -> Array:
    """Return (x, y, phi) as (K, 3) at q (K, n)."""
    theta = np.cumsum(q, axis=1)
    length = np.array(parameters.length_m)
    return np.stack([np.cos(theta) @ length, np.sin(theta) @ length, theta[:, -1]], axis=1)


def tip_velocities(parameters: ArmParameters, q: Array, w: Array) -> Array:
    """Return (x', y', phi') as (K, 3) at q, w (K, n)."""
    theta, speed = np.cumsum(q, axis=1), np.cumsum(w, axis=1)
    length = np.array(parameters.length_m)
    return np.stack([-(np.sin(theta) * speed) @ length, (np.cos(theta) * speed) @ length, speed[:, -1]], axis=1)
