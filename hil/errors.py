"""What can go wrong, by family; each family has its own exit code of the command line.

Every text says which thing, which value, which limit, and the cure.
"""

import traceback


class HilError(Exception):
    """The base of all families."""

    exit_code = 1


class ScenarioError(HilError):
    """A scenario that cannot be run as it stands."""

    exit_code = 3


class ChannelError(HilError):
    """A channel that is busy, missing or not ours."""

    exit_code = 4


class NoBusError(ChannelError):
    """No bus is running on a channel."""


class NodeError(HilError):
    """A node that died, hung or broke the agreement."""

    exit_code = 5


def failed(name: str, error: Exception) -> NodeError:
    """Return what a node's own exception comes to: its name, what was raised, and where."""
    where = traceback.extract_tb(error.__traceback__)[-1]
    return NodeError(f"{name} failed in {where.filename}, line {where.lineno}: {type(error).__name__}: {error}")


class FaultError(HilError):
    """The emulated system stopped itself: the run ended by a Stop frame with a reason other than the end."""

    exit_code = 6


class OutputError(HilError):
    """Results that could not be written."""

    exit_code = 7


class MissingExtraError(HilError):
    """An optional dependency that is not installed."""

    exit_code = 8
