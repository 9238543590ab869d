"""What a person sees of the margins of a loop."""

from rich.console import Console
from rich.table import Table

from hil.timing.limits import CEILING_PERIODS, DelayMargin, Raised
from hil.timing.margin import Margins, ratio
from hil.timing.search import Largest


def show_margins(console: Console, found: Margins) -> None:
    """Print the delays that each joint bears, then g and Jn over the latency; or why there is nothing to print."""
    if found.fails:
        console.print(f"{found.scenario.name} fails as it is, without any delay more: {found.fails}")
        return
    console.print(_delays([*found.delay_margins, *found.with_jitter]))
    if found.largest_g:
        console.print(_raised(found))
    ceiling_us = CEILING_PERIODS * found.scenario.clock.period_s * 1e6
    console.print(f"dead time on top of the scenario's own, {ceiling_us:g} us at most; >: does not fail up to there")
    if found.without_theory:
        console.print(f"no prediction: {found.without_theory}")


def _delays(rows: list[DelayMargin]) -> Table:
    table = _table("dead time that each joint bears, us", "joint", "jitter", "measured", "predicted", "by largest")
    for row in rows:
        by_largest = _text(row.by_largest, 1e6) if row.jitter_s else ""
        jitter = f"0 to {row.jitter_s * 1e6:g}" if row.jitter_s else "none"
        table.add_row(str(row.joint), jitter, *_pair(row, 1e6), by_largest)
    return table


def _raised(found: Margins) -> Table:
    table = _table("largest g and Jn", "dead time\nmore, us", "latency\nus", "g, rad/s\nmeasured", "\npredicted")
    table.add_column("Jn, times\nmeasured", justify="right")
    table.add_column("\npredicted", justify="right")
    for g, Jn in zip(found.largest_g, found.largest_inertia, strict=True):
        table.add_row(f"{g.extra_s * 1e6:g}", f"{g.latency_s * 1e6:.0f}", *_pair(g, 1.0), *_pair(Jn, 1.0, ".3f"))
    return table


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title)
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    return table


def _pair(row: DelayMargin | Raised, factor: float, form: str = ".0f") -> tuple[str, str]:
    """Return what was measured, and the prediction with what was measured over it."""
    share = ratio(row)
    measured, predicted = (_text(each, factor, form) for each in (row.measured, row.predicted))
    return measured, predicted if share is None else f"{predicted} (x {share:.3f})"


def _text(found: Largest | None, factor: float, form: str = ".0f") -> str:
    if found is None:
        return "-"
    if found.value is None:
        return "none"
    return f"{'> ' if found.beyond else ''}{found.value * factor:{form}}"
