"""What a study of a scenario is drawn as: its figures, and the trace of its run."""

from pathlib import Path

from hil.timing.gantt import write_gantt
from hil.timing.response_figure import write_responses
from hil.timing.study import Study
from hil.timing.trace import write_trace
from hil.timing.waterfall import write_waterfalls


def write(folder: Path, study: Study) -> list[Path]:
    """Write gantt, responses, waterfall and waterfall-dsp as PNG and SVG, and trace.json; return their paths.

    Nothing where no frame was ever sent: those that do not fit their cycle are not even tried. Raises MissingExtraError
    without matplotlib, before anything is written.
    """
    outcome, timeline, found = study.outcome, study.timeline, study.found
    if outcome is None or timeline is None or not timeline.frames:
        return []
    scenario = outcome.scenario
    return [
        *write_gantt(folder, scenario, timeline),
        *write_responses(folder, scenario, timeline, found["messages"]),
        *write_waterfalls(folder, scenario.name, found["chains"]),
        write_trace(folder / "trace.json", scenario, timeline),
    ]
