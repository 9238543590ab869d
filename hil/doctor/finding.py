"""What a check comes to."""

from typing import Literal, NamedTuple

Verdict = Literal["ok", "warn", "bad", "unknown"]


class Finding(NamedTuple):
    """One thing that was checked: its value, the limit, the verdict, and how to mend it (empty: nothing to mend).

    bad: a run would fail or lie. warn: it may lose frames or time. unknown: it cannot be read here, or does not exist.
    """

    name: str
    value: str
    limit: str
    verdict: Verdict
    cure: str = ""


def worst(findings: list[Finding]) -> Verdict:
    """Return the worst verdict; what is unknown is no worse than ok."""
    found = {finding.verdict for finding in findings}
    return "bad" if "bad" in found else "warn" if "warn" in found else "ok"
