"""The lab's report: what was to be shown, the figures found, and whether it was; `make lab` writes it.

`python -m tests.lab.report [FOLDER]` reads the row-*.json that the tests of tests/lab/inside leave there (their marker
`row` says which row is theirs), writes report.md beside them and prints it shortly. A row without any is not shown.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

RESULTS = Path(__file__).parents[2] / "build" / "lab"
ROWS = {
    "vcan0": (
        "`paper-joint` and `paper-task`, all processes, vcan0, sync",
        "the payloads of every identifier, in order, equal those of inline `functional`, by hash; the same summary",
    ),
    "cards": ("the same across the two Kvaser cards, 1 Mbit/s", "the same; zero lost"),
    "burst": ("a burst into can0", "ENOBUFS met, counted, nothing lost; receive FIFO overrun counted where it happens"),
    "board": (
        "`--external joint2`, played by the C program, on vcan0 and on can0/can1",
        "payloads identical",
    ),
    "micropython": (
        "`--external joint2`, played by MicroPython on vcan0: as a board, and behind `hil node`",
        "payloads identical",
    ),
    "witnesses": (
        "independent witnesses",
        "candump's identifiers and data in order equal our log; cantools decodes every frame; a `cansend` Stop stops "
        "the arm",
    ),
    "debugger": ("joint 1 stopped for 10 s of wall time in the middle, sync", "result unchanged"),
    "trouble": (
        "interface down and up, link cut, node killed and restarted, sync",
        "time stops; the watchdog names the node and ends with Stop; the rig says what happened; nothing hangs",
    ),
    "wall": (
        "clock `wall`, time dilated by a factor that the lab holds",
        "payloads compared with `functional`; overruns, latency quantiles (p50, p99, p99.9, max) and histogram; "
        "`canbusload -e` against bits per wall second",
    ),
    "timing": (
        "`hil timing -c vcan0`, clock `wall`, dilated",
        "response of every message as quantiles beside its bound; the bound exceeded by the lab's host, misses counted",
    ),
    "wall-trouble": (
        "interface down and up, link cut, node killed and restarted, clock `wall`",
        "the brake is commanded within 3 periods; the rig says what happened; nothing hangs",
    ),
}
"""What is to be shown, and the figure, by the name of the row."""


class Row(NamedTuple):
    """passed: None if no test of it has run."""

    what: str
    figure: str
    got: list[str]
    passed: bool | None

    @property
    def verdict(self) -> str:
        """In a word."""
        return {None: "NOT SHOWN", True: "passed", False: "FAILED"}[self.passed]


def rows(folder: Path) -> list[Row]:
    """Return the rows in order; one that passed has only tests that did."""
    found = [json.loads(path.read_text()) for path in sorted(folder.glob("row-*.json"))]
    made = []
    for name in [*ROWS, *sorted({each["row"] for each in found} - ROWS.keys())]:
        mine = [each for each in found if each["row"] == name]
        passed = all(each["passed"] for each in mine) if mine else None
        made.append(Row(*ROWS.get(name, (name, "")), [text for each in mine for text in each["got"]], passed))
    return made


def closing(folder: Path) -> str:
    """Return how many tests there were, and what time they took."""
    path = folder / "junit.xml"
    if not path.exists():
        return "The tests did not come to their end."
    suite = ElementTree.parse(path).getroot()[0].attrib
    wrong = int(suite["failures"]) + int(suite["errors"])
    return f"{suite['tests']} tests, {wrong} failed, {suite['skipped']} skipped, in {float(suite['time']):.0f} s."


def page(found: Sequence[Row], last: str) -> str:
    """Return the page."""
    lines = ["# The lab's report", "", "| what | figure | got | |", "| --- | --- | --- | --- |"]
    for row in found:
        got = "<br>".join(text.replace("|", "\\|") for text in row.got)
        lines.append(f"| {row.what} | {row.figure} | {got} | {row.verdict} |")
    return "\n".join([*lines, "", last, ""])


def main(folder: Path = RESULTS) -> int:
    """Write the page, print the verdicts; return 1 if anything was not shown."""
    found = rows(folder)
    (folder / "report.md").write_text(page(found, closing(folder)))
    for row in found:
        print(f"lab: {row.verdict:9}  {row.what}")
    print(f"lab: {folder / 'report.md'}")
    return 0 if all(row.passed for row in found) else 1


def clear(folder: Path) -> None:
    """Remove what tests before these have left."""
    for path in (*folder.glob("row-*.json"), folder / "report.md", folder / "junit.xml"):
        path.unlink(missing_ok=True)


if __name__ == "__main__":
    sys.exit(main(*map(Path, sys.argv[1:])))
