"""What a person sees of a run: its progress on stderr, its result as a table on stdout."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from hil.experiment import Result
from hil.paper.report import Section

Step = Callable[[float], None]
Notice = Callable[[str], None]


@contextmanager
def progress(title: str, quiet: bool) -> Iterator[tuple[Step, Notice]]:
    """Give (what takes the share done, what takes a notice); on stderr, and only if somebody watches."""
    with _bar(quiet, TextColumn("{task.percentage:3.0f} %"), TimeElapsedColumn()) as (bar, notice):
        task = bar.add_task(f"{title}: starting", total=1.0)
        yield lambda share: bar.update(task, completed=share, description=title), notice


@contextmanager
def counting(title: str, total: int, quiet: bool) -> Iterator[tuple[Callable[[int, str], None], Notice]]:
    """Give (what takes how many are done, and what they came to; what takes a notice), as above, with the time left."""
    with _bar(quiet, MofNCompleteColumn(), TimeRemainingColumn(elapsed_when_finished=True)) as (bar, notice):
        task = bar.add_task(f"{title}: starting", total=total)

        def step(done: int, text: str) -> None:
            if bar.tasks[0].description.endswith("starting"):  # what was there before says nothing of the speed
                bar.reset(task, completed=done, total=total)
            bar.update(task, completed=done, description=f"{title}: {text}")

        yield step, notice


@contextmanager
def _bar(quiet: bool, *columns: ProgressColumn) -> Iterator[tuple[Progress, Notice]]:
    console = Console(stderr=True, markup=False, highlight=False)
    every = (TextColumn("{task.description}"), BarColumn(), *columns)
    with Progress(*every, console=console, transient=True, disable=quiet or not console.is_terminal) as bar:
        yield bar, lambda text: console.print(f"hil: {text}", soft_wrap=True)


def result(found: Result, folder: Path | None) -> None:
    """Print the result."""
    console = Console(markup=False, highlight=False)
    summary = found.summary
    console.print(_headline(summary), soft_wrap=True)
    if found.evaluation is not None:
        console.print(_joints(summary))
        console.print(_task(summary))
    for title, run in _columns(summary):
        for line in _world(run):
            console.print(f"{title}: {line}", soft_wrap=True)
    if "real_time" in summary:
        _real_time(console, summary["real_time"])
    for name, counted in summary.get("samples", {}).items():
        console.print(f"samples of {name}, by its own timer: {_causes(counted)}", soft_wrap=True)
    for name, clocks in summary.get("clocks", {}).items():
        console.print(f"{name}, an 8086: {_clocks(clocks)}", soft_wrap=True)
    for key in ("lost_frames_by_cause", "deadline_misses_by_cause", "saturations_by_signal"):
        causes = ", ".join(f"{cause}: {count}" for cause, count in summary[key].items() if count)
        if causes:
            console.print(f"{key.replace('_', ' ')}: {causes}", soft_wrap=True)
    if folder is not None:
        console.print(f"run folder: {folder}", soft_wrap=True)


def _clocks(counted: dict[str, Any]) -> str:
    """Return the clocks of its control interrupt, and what they are in us."""
    MHz = counted["clock_hz"] * 1e-6
    us = [counted[key] / MHz for key in ("least", "most")]
    return (
        f"{counted['least']} to {counted['most']} clocks an interrupt, {counted['mean']:.1f} in the mean: "
        f"{us[0]:.1f} to {us[1]:.1f} us at {MHz:g} MHz"
    )


def _real_time(console: Console, figures: dict[str, Any]) -> None:
    """Print how late everything was, by the machine's clock."""
    pace = "real time" if figures["pace"] == 1.0 else f"time dilated {1 / figures['pace']:g} times"
    table = Table(title=f"by the clock, {pace}: us of wall time")
    for column in ("", "p50", "p99", "p99.9", "largest"):
        table.add_column(column, justify="right" if column else "left")
    rows = {"Sync behind its deadline": figures["sync_late"], "Sync to Sync": figures["sync_interval"]}
    rows |= {f"{name} behind Sync": found for name, found in figures["since_sync"].items()}
    for title, found in rows.items():
        if found is not None:
            table.add_row(title, *(f"{found[key] * 1e6:.0f}" for key in ("p50_s", "p99_s", "p99.9_s", "max_s")))
    console.print(table)
    console.print(
        f"overruns {figures['overruns']}, cycles skipped {figures['skipped_cycles']}, "
        f"stamps older than the plant's present {figures['old_stamps']}, steps of the clock {figures['clock_steps']}"
    )
    for node, lines in [*figures["refused"].items(), *figures["bus_trouble"].items()]:
        for line in lines:
            console.print(f"{node}: {line}", soft_wrap=True)


def report(sections: list[Section], with_tables: bool, folder: Path | None) -> None:
    """Print what the paper claims beside what was measured, and the tables behind it if wanted."""
    console = Console(markup=False, highlight=False)
    for part in [part for section in sections for part in section.tables if with_tables]:
        table = Table(*part.header, title=part.title)
        for row in part.rows:
            table.add_row(*row)
        console.print(table)
    table = Table("the paper says", "where", "we measure", "holds", show_lines=True)
    for claim in [claim for section in sections for claim in section.claims]:
        table.add_row(claim.says, claim.where, claim.measured, claim.verdict)
    console.print(table)
    if folder is not None:
        console.print(f"page: {folder / 'index.html'}", soft_wrap=True)


def counters(report: dict[str, Any]) -> str:
    """Return what a node counted, by cause, in a line; zeros are left out."""
    found = []
    for cause, count in report.items():
        if isinstance(count, dict) and cause != "process":
            found += [f"{cause} of {name}: {number}" for name, number in count.items() if number]
        elif count and isinstance(count, int | str) and cause != "braked_ns":
            found.append(f"{cause.replace('_', ' ')}: {count}")
    return ", ".join(found) or "nothing was lost, missed or saturated"


def _headline(summary: dict[str, Any]) -> str:
    load = "" if summary["bus_load"] is None else f", bus load {summary['bus_load']:.1%}"
    speed = summary["simulated_s"] / summary["wall_s"]
    return (
        f"{summary['scenario']} ({summary['mode']}, {summary['fidelity']}): {summary['simulated_s']:.3f} s in "
        f"{summary['wall_s']:.2f} s ({speed:.1f} x real time), started in {summary['startup_s']:.2f} s\n"
        f"{summary['cycles']} cycles, {summary['frames']} frames{load}, lost {summary['lost_frames']}, "
        f"deadline misses {summary['deadline_misses']}, saturations {summary['saturations']}\n"
        f"frame log sha256 {summary['frame_log_sha256']}"
    )


def _columns(summary: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """Return the runs to show beside each other, the one asked for first."""
    runs = [summary] + ([summary["counterpart"]] if "counterpart" in summary else [])
    return [(_controller(run), run) for run in runs]


def _controller(run: dict[str, Any]) -> str:
    if run["law"] == "computed-torque":
        return "computed torque"
    return "observer on" if run["observer"] else "observer off"


def _joints(summary: dict[str, Any]) -> Table:
    table = Table(title="joint deviation, urad")
    table.add_column("joint")
    for title, _ in _columns(summary):
        table.add_column(f"{title}\nlargest", justify="right")
        table.add_column("\nfinal (rms)", justify="right")
    for n in range(len(summary["max_deviation_rad"])):
        cells = [
            f"{run[key][n] * 1e6:.1f}"
            for _, run in _columns(summary)
            for key in ("max_deviation_rad", "final_deviation_rad")
        ]
        table.add_row(str(n + 1), *cells)
    return table


def _task(summary: dict[str, Any]) -> Table:
    table = Table(title=f"tip deviation (peak command speed {summary['peak_command_speed_m_s'] * 100:.1f} cm/s)")
    table.add_column("axis")
    for title, _ in _columns(summary):
        table.add_column(f"{title}\nvelocity, cm/s", justify="right")
        table.add_column("\nposition, mm", justify="right")
    for k, axis in enumerate("xy"):
        cells = []
        for _, run in _columns(summary):
            cells.append(f"{run['max_velocity_deviation_m_s'][k] * 100:.2f}")
            cells.append(f"{run['max_position_deviation_m'][k] * 1000:.3f}")
        table.add_row(axis, *cells)
    return table


def _world(summary: dict[str, Any]) -> Iterator[str]:
    """Yield what happened between the hand and the world."""
    for name, contact in summary.get("contact", {}).items():
        if contact["largest_normal_N"] > 0.0:
            yield (
                f"{name}: largest contact force {contact['largest_normal_N']:.2f} N "
                f"(friction {contact['largest_tangential_N']:.2f} N), final {contact['final_normal_N']:.3f} N "
                f"at a depth of {contact['final_depth_m'] * 1000:.4f} mm, varying by {contact['final_span_N']:.2g} N"
            )
    for name, body in summary.get("bodies", {}).items():
        moves = zip(body["start_m_m_rad"], body["final_m_m_rad"], strict=True)
        x, y, angle = (last - first for first, last in moves)
        yield f"{name}: moved by ({x * 1000:.2f}, {y * 1000:.2f}) mm, turned by {angle:.3f} rad"
    if summary.get("missed_grasps"):
        yield f"missed grasps: {summary['missed_grasps']}: the hand closed where no payload was"


def bus_status(channel: str, status: dict[str, Any]) -> None:
    """Print how a bus stands: its clock, whom it waits for, and what every controller counted."""
    console = Console(markup=False, emoji=False)
    pace = "as fast as it goes" if status["pace"] is None else f"{status['pace']:g} x real time"
    console.print(f"bus {channel!r} at {status['now_ns'] * 1e-9:.6f} s, {'paused' if status['paused'] else pace}")
    if status["waiting_for"]:
        console.print(f"waiting for {status['waiting_for']['name']} for {status['waiting_for']['seconds']:.1f} s")
    if status["missing"]:
        console.print(f"not there yet: {', '.join(status['missing'])}")
    for reason in status["died"]:
        console.print(f"removed: {reason}")
    table = Table()
    for column in ("node", "channel", "state", "TEC", "REC", "sent", "got", "again", "errors", "lost"):
        table.add_column(column)
    for name, node in status["nodes"].items():
        counts = [str(node[key]) for key in ("tec", "rec", "sent", "received", "repeated")]
        table.add_row(name, node["channel"], node["state"], *counts, _causes(node["errors"]), _causes(node["lost"]))
    console.print(table)


def _causes(counts: dict[str, int]) -> str:
    return ", ".join(f"{cause} {count}" for cause, count in counts.items()) or "0"
