"""The nominal inertia of each joint: the least inertia that its motor ever feels.

Units: kg m^2. Ref: eq. (2). Jn is the minimum of 1 / (M^-1)_ii over the workspace without payload. A payload
or another pose only raises the true inertia, which is the side on which the observer is stable.
"""

from itertools import product

import numpy as np

from plant.array_form import Array, inertia
from plant.parameters import ArmParameters, Vector

_GRID = 20_000  # poses of the first search; M does not depend on q_1
_KEPT = 8  # best poses that are refined
_SHRINK = 0.7
_TOLERANCE_RAD = 1e-9


def nominal_inertia(parameters: ArmParameters) -> Vector:
    """Return the minimum of 1 / (M^-1)_ii over all poses, without payload: grid of some 20 000 poses, then refined."""
    dimensions = parameters.joints - 1
    points = int(_GRID ** (1 / max(dimensions, 1)))
    axis = np.linspace(-np.pi, np.pi, points, endpoint=False)
    poses = np.array(list(product(axis, repeat=dimensions)))
    felt = _felt_inertia(parameters, poses)
    starts = np.argsort(felt, axis=0)[:_KEPT]
    return tuple(
        _refine(parameters, joint, poses[starts[:, joint]], 2 * np.pi / points) for joint in range(dimensions + 1)
    )


def _felt_inertia(parameters: ArmParameters, poses: Array) -> Array:
    """Return 1 / (M^-1)_ii (K, n) at poses (K, n - 1) of joints 2 to n."""
    q = np.concatenate([np.zeros((len(poses), 1)), poses], axis=1)
    M = inertia(parameters, q, np.zeros(len(q)))
    return np.asarray(1.0 / np.diagonal(np.linalg.inv(M), axis1=1, axis2=2))


def _refine(parameters: ArmParameters, joint: int, poses: Array, reach: float) -> float:
    """Return the least felt inertia near the poses: compass search with a shrinking reach."""
    steps = np.concatenate([np.zeros((1, poses.shape[1])), np.eye(poses.shape[1]), -np.eye(poses.shape[1])])
    least = np.inf
    while reach > _TOLERANCE_RAD:
        around = poses[:, None, :] + reach * steps
        felt = np.stack([_felt_inertia(parameters, some)[:, joint] for some in around])
        best = felt.argmin(axis=1)
        poses = around[np.arange(len(poses)), best]
        least = min(least, float(felt.min()))
        reach *= _SHRINK if not best.any() else 1.0
    return least
