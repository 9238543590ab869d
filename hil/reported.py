"""What a command of `hil` says when something goes wrong, and the exit code that it ends with."""

import functools
import signal
import sys
from collections.abc import Callable
from typing import Any, NoReturn, ParamSpec

import typer

from hil.errors import FaultError, HilError

P = ParamSpec("P")

INTERRUPTED = 130


def reported(command: Callable[P, None]) -> Callable[P, None]:
    """Turn an error of ours into its message and its family's exit code."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        for number in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, _terminate)
        try:
            command(*args, **kwargs)
        except HilError as error:
            _complain(str(error), error.exit_code)
        except KeyboardInterrupt:
            _complain("interrupted: everything was ended", INTERRUPTED)
        except Terminated as end:
            _complain(f"{end}: everything was ended", 128 + end.number)

    return run


def refuse_faults(faults: list[dict[str, Any]]) -> None:
    """Raise FaultError with what stopped a run before its end; nothing where it came to it. faults: hil.summary's."""
    for fault in faults:
        raise FaultError(f"the run stopped at {fault['time_s']:.3f} s: {fault['node']}: {fault['cause']}")


def _complain(text: str, exit_code: int) -> NoReturn:
    print(f"hil: {text}", file=sys.stderr)
    raise typer.Exit(exit_code) from None


class Terminated(BaseException):
    """The process was told to end, by a signal other than Ctrl-C's."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


def _terminate(number: int, _frame: Any) -> NoReturn:
    raise Terminated(number)
