"""Scenarios drawn at random: short, and of every kind that the fast engine covers."""

from random import Random
from typing import Any

from dbc.compiler import load_arm
from hil import constants, scenario_file
from hil.errors import ScenarioError
from hil.scenario import Scenario

JOINTS = (3, 3, 3, 3, 1, 2, 4, 5, 6)
CODEC = load_arm()


def drawn(seed: int) -> Scenario:
    """Return the scenario of a seed: the first of its draws that no check refuses. Half of them are well set up."""
    draw = Random(seed)
    while True:
        values = _values(draw, seed)
        if seed % 2 == 0:
            _set_up_well(values)
        try:
            scenario = scenario_file.build(values)
            constants.action_delays_ns(scenario)
            for joint in range(1, scenario.joints + 1):
                constants.parameter_table(scenario, joint, CODEC)
        except ScenarioError:
            continue
        return scenario


def _set_up_well(values: dict[str, Any]) -> None:
    """Let the joints know their motors, and leave the currents room: what saturates otherwise hides all the rest."""
    values["joint"] |= {
        "limit_A": 15.0,
        "inertia_kg_m2": values["arm"]["rotor_inertia_kg_m2"],
        "torque_constant_N_m_A": values["drive"]["torque_constant_N_m_A"],
    }
    values["drive"]["limit_A"] = 16.0
    values["encoder"]["counts_per_turn"] = 819_200
    values["brake"]["torque_N_m"] = [60.0] * len(values["start_rad"])


def _values(draw: Random, seed: int) -> dict[str, Any]:
    joints = draw.choice(JOINTS)
    period_s = draw.choice((0.001, 0.001, 0.0005, 0.002))
    duration_s = draw.randint(30, 70) * period_s
    values: dict[str, Any] = {
        "name": f"drawn-{seed}",
        "duration_s": duration_s,
        "bus": {"fidelity": "functional"},
        "clock": {"period_s": period_s, "setup_cycles": draw.randint(90, 110)},
        "arm": _arm(draw, joints),
        "drive": _drive(draw, joints, period_s),
        "joint": _joint(draw, joints),
        "brake": {"torque_N_m": [draw.choice((60.0, 30.0, 0.5)) for _ in range(joints)]},
        "encoder": {"counts_per_turn": draw.choice((819_200, 200_000, 65_536, 4_000_000))},
        "load": [_during(draw, duration_s, mass_kg=draw.uniform(0.1, 3.0)) for _ in range(draw.choice((0, 0, 1, 2)))],
        "torque": [_torque(draw, joints, duration_s) for _ in range(draw.choice((0, 0, 1, 3)))],
    }
    if draw.random() < 0.3 or period_s < 0.001:
        values["bus"]["action_delay_s"] = [draw.randrange(0, round(period_s * 1e6)) * 1e-6 for _ in range(joints)]
    if draw.random() < 0.15:  # currents that act exactly where a period begins
        values["bus"]["action_delay_s"] = [round(draw.randrange(4) * period_s / 4, 9) for _ in range(joints)]
        values["drive"]["dead_time_s"] = [round(draw.randrange(9) * period_s / 4, 9) for _ in range(joints)]
    return values | _motion(draw, joints, duration_s)


def _arm(draw: Random, joints: int) -> dict[str, Any]:
    friction = [draw.choice((0.0, draw.uniform(0.1, 5.0))) for _ in range(joints)]
    return {
        "lengths_m": [draw.uniform(0.1, 0.4) for _ in range(joints)],
        "masses_kg": [draw.uniform(0.2, 3.0) for _ in range(joints)],
        "rotor_inertia_kg_m2": [draw.uniform(0.05, 1.5) for _ in range(joints)],
        "viscosity_N_m_s": [draw.choice((0.0, draw.uniform(0.0, 3.0))) for _ in range(joints)],
        "coulomb_N_m": draw.choice((friction, [0.0] * joints)),
        "gravity_m_s2": draw.choice((9.80665, 9.80665, 0.0)),
    }


def _drive(draw: Random, joints: int, period_s: float) -> dict[str, Any]:
    drive: dict[str, Any] = {
        "torque_constant_N_m_A": [draw.uniform(2.0, 10.0) for _ in range(joints)],
        "limit_A": draw.choice((8.0, 8.0, 1.5)),
        "lag_s": draw.choice((0.0, 0.0, 0.0, 5e-4, 2e-3)),
        "seed": draw.randrange(100),
    }
    if draw.random() < 0.3:
        drive["ripple"] = [draw.choice((0.0, draw.uniform(0.0, 0.05))) for _ in range(joints)]
    if draw.random() < 0.3:
        drive["dead_time_s"] = [draw.randrange(0, 3000) * 1e-6 for _ in range(joints)]
    if draw.random() < 0.3:
        drive["dead_time_jitter_s"] = [draw.randrange(0, round(period_s * 5e5)) * 1e-6 for _ in range(joints)]
    return drive


def _joint(draw: Random, joints: int) -> dict[str, Any]:
    return {
        "observer": draw.random() < 0.8,
        "g_rad_s": draw.choice((450.0, 300.0, 150.0)),
        "inertia_kg_m2": [draw.uniform(0.08, 1.4) for _ in range(joints)],
        "torque_constant_N_m_A": [draw.uniform(2.0, 10.0) for _ in range(joints)],
        "limit_A": draw.choice((8.0, 8.0, 12.0, 1.0)),
        "word": _word(draw) if draw.random() < 0.5 else {},
    }


def _word(draw: Random) -> dict[str, Any]:
    roundings = ("floor", "nearest", "convergent", "toward-zero")
    word: dict[str, Any] = {f"round_{what}": draw.choice(roundings) for what in ("d", "estimate", "reference")}
    word |= {"bits": draw.choice((8, 10, 12, 16, 16, 20, 24, 32)), "overflow": draw.choice(("saturate", "wrap"))}
    if word["bits"] < 12 or draw.random() < 0.3:
        word["kb_fraction"] = draw.randint(-2, 6)
    if draw.random() < 0.5:
        word["d_fraction"] = draw.randint(0, 30)
    return word


def _motion(draw: Random, joints: int, duration_s: float) -> dict[str, Any]:
    start = [draw.uniform(-1.5, 1.5) for _ in range(joints)]
    time_s = duration_s * draw.choice((0.6, 0.9, 5.0))
    if joints != 3 or draw.random() < 0.6:
        by = [draw.choice((0.01, 0.01, 0.01, 2.0)) * draw.uniform(-1.0, 1.0) for _ in range(joints)]
        return {"start_rad": start, "trajectory": {"kind": "quintic", "by_rad": by, "time_s": time_s}}
    start[1] = draw.choice((-1.0, 1.0)) * draw.uniform(0.5, 2.5)
    line = {"kind": "line", "by_m": [draw.uniform(-0.004, 0.004) for _ in range(2)], "time_s": time_s}
    circle = {"kind": "circle", "radius_m": draw.uniform(0.0001, 0.001), "time_s": time_s}
    space = draw.choice(("joint", "task", "task"))
    return {"start_rad": start, "trajectory": draw.choice((line, circle)), "dsp": {"space": space}}


def _torque(draw: Random, joints: int, duration_s: float) -> dict[str, Any]:
    frequency = draw.choice((0.0, draw.uniform(10.0, 2000.0)))
    wave = {"joint": draw.randint(1, joints), "amplitude_N_m": draw.uniform(-10.0, 10.0), "frequency_rad_s": frequency}
    return _during(draw, duration_s, **wave)


def _during(draw: Random, duration_s: float, **values: float) -> dict[str, Any]:
    at_us, until_us = sorted(draw.sample(range(round(duration_s * 1e6)), 2))
    return values | {"at_s": at_us * 1e-6, "until_s": until_us * 1e-6}
