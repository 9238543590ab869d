"""What a scenario may ask for, but will not get: warned of, not refused.

Units: N m, kg, s. Ref: eq. (1), g(q).
"""

from collections.abc import Iterator

import numpy as np

from dbc.compiler import load_arm
from firmware_py.dsp import kinematics
from hil.assemble import arm_parameters, joint_trajectory
from hil.scenario import Load, Scenario
from hil.scenario_world import Grasp
from plant.array_form import gravity

_INSTANTS = 500


def warnings(scenario: Scenario) -> Iterator[str]:
    """Yield each load and payload that a drive cannot hold against gravity along the commanded motion."""
    loads: list[tuple[str, Load | Grasp]] = [(f"load.{k}", load) for k, load in enumerate(scenario.load)]
    loads += [(f"grasp.{k}", grasp) for k, grasp in enumerate(scenario.grasp)]
    for name, load in loads:
        needed = _needed_Nm(scenario, load)
        limit_A = min(scenario.drive.limit_A, scenario.joint.limit_A)
        for n, torque in enumerate(needed):
            constant = scenario.drive.torque_constant_N_m_A[n]
            if torque > limit_A * constant:
                yield (
                    f"{name}: with {load.mass_kg:g} kg joint {n + 1} must hold up to {torque:.1f} N m against gravity, "
                    f"but its drive gives {limit_A * constant:.1f} N m ({limit_A:g} A): it will sink; "
                    "lighten the load, or raise limit_A of drive and joint"
                )


def _needed_Nm(scenario: Scenario, load: Load | Grasp) -> list[float]:
    """Return the largest torque of gravity on every joint while the load is on the hand; [] if no path leads there."""
    instants = np.linspace(load.at_s, load.until_s, _INSTANTS)
    motion = joint_trajectory(scenario)
    try:
        poses = np.array([motion.at(float(t_s))[0] for t_s in instants])
    except (kinematics.OutOfReach, kinematics.SingularPoint):
        return []
    others: list[Load | Grasp] = [*scenario.load, *scenario.grasp]
    on_hand = sum((each.mass_kg for each in others if each.at_s <= load.at_s < each.until_s), 0.0)
    torques = gravity(arm_parameters(scenario, load_arm()), poses, np.full(len(poses), on_hand))
    largest: list[float] = np.max(np.abs(torques), axis=0).tolist()
    return largest
