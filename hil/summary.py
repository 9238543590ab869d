"""The summary of a run: what `--json` prints and summary.json holds."""

import platform
from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np

from firmware_py.joint_cpu import STOP_JOINT_FAULT
from hil.constants import STOP_OPERATOR, STOP_REASONS
from hil.evaluate import Array, Evaluation
from hil.rig import Outcome
from hil.wall_summary import real_time
from plant.node import STOP_CURRENT_LOST

STOP_IDENTIFIER = 0x010
OF_OTHERS = ("sync", "wall")
"""Modes on a bus that is not ours: it tells neither who sends a Stop nor how many bits there were."""
NO_FAULT = ("", "stopped")
"""What a node says that is well, or only heard a Stop."""
LOST_BY = ("crc_errors", "unsent")
MISSED_BY = (
    "skipped_status",
    "strikes",
    "missed_encoders",
    "late_currents",
    "overdue_currents",
    "missed_currents",
    "repeated_currents",
    "missed_references",
    "repeated_parameters",
    "repeated_encoders",
    "skipped_cycles",
    "old_stamps",
)


def summarise(outcome: Outcome, evaluation: Evaluation | None, startup_s: float) -> dict[str, Any]:
    """Return the summary as JSON-ready values. startup_s: wall time from the command to cycle 0."""
    scenario, frames = outcome.scenario, outcome.log.frames
    simulated_s = (frames[-1][0] * 1e-9) if frames else 0.0
    return {
        "scenario": scenario.name,
        "clock": scenario.clock.kind,
        "fidelity": scenario.bus.fidelity,
        "mode": outcome.mode,
        "observer": scenario.joint.observer,
        "law": scenario.dsp.law,
        "simulated_s": min(simulated_s, scenario.duration_s),
        "wall_s": outcome.wall_s,
        "startup_s": startup_s,
        "cycles": 0 if evaluation is None else len(evaluation.t_s),
        "frames": len(frames),
        "frame_log_sha256": outcome.log.sha256(),
        "deterministic": outcome.deterministic,
        "bus_load": _bus_load(outcome, simulated_s),
        "lost_frames": sum(_lost(outcome).values()),
        "lost_frames_by_cause": _lost(outcome),
        "bus_errors": _bus_errors(outcome),
        "wire": outcome.wire,
        "deadline_misses": sum(_missed(outcome).values()),
        "deadline_misses_by_cause": _missed(outcome),
        "saturations": sum(_saturations(outcome).values()),
        "saturations_by_signal": {name: count for name, count in _saturations(outcome).items() if count},
        "faults": faults(outcome),
        **({} if evaluation is None else deviations(evaluation)),
        **({} if evaluation is None else world(evaluation)),
        **real_time(outcome),
        **samples(outcome),
        **machine_code(outcome),
        **({"missed_grasps": outcome.reports["plant"]["missed_grasps"]} if scenario.has_world else {}),
        "processes": {name: report["process"] for name, report in outcome.reports.items() if "process" in report},
        "platform": f"Python {platform.python_version()}, {' '.join(platform.libc_ver())}, {platform.machine()}",
    }


def _bus_errors(outcome: Outcome) -> int:
    """Return how many errors all controllers have detected; an overload frame is none."""
    return sum(sum(node["errors"].values()) - node["errors"].get("overload", 0) for node in outcome.wire.values())


def _lost(outcome: Outcome) -> dict[str, int]:
    """Return the frames that somebody did not get, or could not send, by cause."""
    lost = Counter({"slow observers": outcome.lost_frames, **_counts(outcome, LOST_BY)})
    for node in outcome.wire.values():
        lost.update(node["lost"])
    return dict(lost)


def deviations(evaluation: Evaluation) -> dict[str, Any]:
    """Return the deviations in joint and task space."""
    final = evaluation.deviation[evaluation.final_rows]
    speed = np.sqrt(np.sum(evaluation.v_cmd**2, axis=1))
    return {
        "max_deviation_rad": _largest(evaluation.deviation),
        "final_deviation_rad": np.sqrt(np.mean(final**2, axis=0)).tolist(),
        "peak_command_speed_m_s": float(np.max(speed)),
        "max_velocity_deviation_m_s": _largest(evaluation.v_cmd - evaluation.v),
        "max_position_deviation_m": _largest(evaluation.x_cmd - evaluation.x),
    }


def world(evaluation: Evaluation) -> dict[str, Any]:
    """Return what the tip felt of every surface, and where every body went; nothing without a world."""
    recorded = evaluation.world
    if not recorded:
        return {}
    surfaces = [name.removesuffix("_depth_m") for name in recorded if name.endswith("_depth_m")]
    bodies = [name.removesuffix("_x_m") for name in recorded if name.endswith("_x_m")]
    return {
        "contact": {name: _contact(recorded, name, evaluation.final_rows) for name in surfaces},
        "bodies": {name: _moved(recorded, name) for name in bodies},
    }


def _contact(recorded: dict[str, Array], name: str, final: slice) -> dict[str, float]:
    """Return the largest forces, and force, its span and depth of the last 100 ms."""
    normal, tangential = recorded[f"{name}_normal_N"], recorded[f"{name}_tangential_N"]
    return {
        "largest_normal_N": float(np.max(normal)),
        "largest_tangential_N": float(np.max(np.abs(tangential))),
        "final_normal_N": float(np.mean(normal[final])),
        "final_span_N": float(np.ptp(normal[final])),
        "final_depth_m": float(np.mean(recorded[f"{name}_depth_m"][final])),
    }


def _moved(recorded: dict[str, Array], name: str) -> dict[str, list[float]]:
    columns = [recorded[f"{name}_{what}"] for what in ("x_m", "y_m", "angle_rad")]
    return {"start_m_m_rad": [float(c[0]) for c in columns], "final_m_m_rad": [float(c[-1]) for c in columns]}


def samples(outcome: Outcome) -> dict[str, Any]:
    """Return what each joint by its own timer counted of its samples; nothing where every joint follows the Encoder."""
    reports = {name: report for name, report in outcome.reports.items() if "beats" in report}
    counted = {
        name: {"doubled": each["doubled_samples"], "missed": each["missed_samples"], "beats": each["beats"]}
        for name, each in reports.items()
    }
    return {"samples": counted} if counted else {}


def machine_code(outcome: Outcome) -> dict[str, Any]:
    """Return the clocks of a control interrupt of each joint of machine code, and its clock; nothing without any."""
    counted = {
        name: report["clocks"] | {"clock_hz": outcome.scenario.of_joint(int(name.removeprefix("joint")), "clock_hz")}
        for name, report in outcome.reports.items()
        if "clocks" in report
    }
    return {"clocks": counted} if counted else {}


def faults(outcome: Outcome) -> list[dict[str, Any]]:
    """Return why the run did not come to its end: one entry, the Stop frame that ended it; none if it did."""
    if not outcome.log.frames:
        return [_fault(0.0, "dsp", "set-up failed", _cause(outcome, "dsp"))]
    end_ns, identifier, data, sender = outcome.log.frames[-1]
    if identifier != STOP_IDENTIFIER or len(data) != 1:
        node = _troubled(outcome)
        cause = "the frames end without one" if node is None else _cause(outcome, node)
        return [_fault(end_ns * 1e-9, node or "bus", "no Stop", cause)]
    if data[0] != 0:
        reason = STOP_REASONS.get(data[0], f"reason {data[0]}")
        node = _speaker(outcome, data[0]) if outcome.mode in OF_OTHERS else sender
        cause = "a Stop by hand" if data[0] == STOP_OPERATOR else _cause(outcome, node)
        return [_fault(end_ns * 1e-9, node, reason, cause)]
    if sender != "dsp" or end_ns < outcome.scenario.duration_ns:
        return [_fault(end_ns * 1e-9, sender, "Stop before the end", "a Stop that the DSP did not send at the end")]
    return []


def _speaker(outcome: Outcome, reason: int) -> str:
    """Return who said Stop on a bus that does not tell: by its reason, and for a joint by who is in fault."""
    if reason == STOP_JOINT_FAULT:
        return _troubled(outcome, "joint") or "a joint"
    return {STOP_OPERATOR: "somebody", STOP_CURRENT_LOST: "plant"}.get(reason, "dsp")


def _troubled(outcome: Outcome, part: str = "") -> str | None:
    """Return the first node of a part that is in a fault of its own."""
    reports = outcome.reports.items()
    return next((name for name, each in reports if name.startswith(part) and each["fault"] not in NO_FAULT), None)


def _cause(outcome: Outcome, node: str) -> str:
    return outcome.reports.get(node, {}).get("fault") or "no cause given"


def _fault(time_s: float, node: str, reason: str, cause: str) -> dict[str, Any]:
    return {"time_s": time_s, "node": node, "reason": reason, "cause": cause}


def _largest(values: Array) -> list[float]:
    largest: list[float] = np.max(np.abs(values), axis=0).tolist()
    return largest


def _bus_load(outcome: Outcome, simulated_s: float) -> float | None:
    """Return the share of time that frames and intermissions take; None where they take none."""
    if outcome.scenario.bus.fidelity == "functional" or simulated_s == 0.0 or outcome.mode in OF_OTHERS:
        return None
    return outcome.bits_on_wire * outcome.scenario.bit_ns * 1e-9 / simulated_s


def _counts(outcome: Outcome, causes: Iterable[str]) -> dict[str, int]:
    """Return each node's counter of each cause."""
    found = {}
    for name, report in outcome.reports.items():
        for cause in causes:
            count = report.get(cause, 0)
            found[f"{name} {cause}"] = sum(count.values()) if isinstance(count, dict) else count
    return {name: count for name, count in found.items() if count}


def _missed(outcome: Outcome) -> dict[str, int]:
    """Return what came late or not at all, by cause."""
    missing = outcome.clock.get("missing_frames", {})
    return _counts(outcome, MISSED_BY) | {f"{name} not in its cycle": count for name, count in missing.items()}


def _saturations(outcome: Outcome) -> dict[str, int]:
    """Return the saturations of every named signal."""
    return {
        f"{node} {signal}": count
        for node, report in outcome.reports.items()
        for signal, count in report.get("saturations", {}).items()
    }
