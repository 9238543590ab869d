"""What a person sees of findings: a table, and below it the cures, each to be pasted in one piece."""

from rich.console import Console
from rich.table import Table

from hil.doctor.finding import Finding

STYLES = {"ok": "green", "warn": "yellow", "bad": "bold red", "unknown": "dim"}


def findings(title: str, found: list[Finding]) -> None:
    """Print findings and cures on stdout."""
    console = Console(markup=False, highlight=False)
    table = Table("", "check", "found", "wanted", title=title)
    for each in found:
        table.add_row(each.verdict, each.name, each.value, each.limit, style=STYLES[each.verdict])
    console.print(table)
    for each in found:
        if each.cure:
            console.print(f"{each.name}: {each.cure}", soft_wrap=True)
