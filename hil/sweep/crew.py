"""Who runs the points: processes of this machine, or a Dask cluster; either way an Executor."""

import os
import re
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from hil.errors import ChannelError, HilError, MissingExtraError, NodeError
from hil.pool import pool

ADDRESS = re.compile(r"(?:tcp://)?(?P<host>[\w.-]+|\[[\w:.%]+\]):(?P<port>\d{1,5})")
LARGEST_PORT = 65_535
PATIENCE_S = 5
"""For a scheduler that does not answer, and a cluster without workers."""
CURE = "start one with `dask scheduler`, and workers with `dask worker ADDRESS`"


@dataclass(frozen=True)
class Crew:
    """An executor, how many points it runs at once, and a look whether it still can, which raises HilError."""

    executor: Executor
    size: int
    check: Callable[[], None]


@contextmanager
def processes(jobs: int | None) -> Iterator[Crew]:
    """Give processes of this machine; default: one a CPU that is ours."""
    size = jobs or len(os.sched_getaffinity(0))
    with pool(size) as executor:
        yield Crew(executor, size, lambda: None)


@contextmanager
def cluster(address: str) -> Iterator[Crew]:
    """Give the Dask cluster of the scheduler at HOST:PORT; raise ChannelError where there is none, or no worker."""
    client = _connected(address)
    try:
        size = sum(_workers(client, address).values())
        yield Crew(client.get_executor(pure=False), size, lambda: _look(client, address))
    except HilError:
        raise
    except Exception as error:
        raise NodeError(
            f"scheduler {address}: {type(error).__name__}: {str(error)[:300]}: what is done is kept; look at the "
            "workers, whose hil must be the same as this one, and give the same command again"
        ) from None
    finally:
        client.close(timeout=PATIENCE_S)


def _connected(address: str) -> Any:
    found = ADDRESS.fullmatch(address)
    if found is None or int(found["port"]) > LARGEST_PORT:
        raise ChannelError(f"scheduler {address!r}: write HOST:PORT, for example 127.0.0.1:8786; {CURE}")
    try:
        from distributed import Client
    except ImportError:
        raise MissingExtraError("--scheduler needs Dask, which is not installed: pip install 'hil[sweep]'") from None
    try:
        # first a bare connection: it is refused at once, where Dask would try again
        socket.create_connection((found["host"].strip("[]"), int(found["port"])), PATIENCE_S).close()
        make: Any = Client
        return make(address, timeout=PATIENCE_S, set_as_default=False)
    except (OSError, OverflowError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ChannelError(f"scheduler {address}: {reason}: {CURE}") from None


def _workers(client: Any, address: str) -> dict[str, int]:
    """Return the threads of each worker; wait a little for the first."""
    try:
        client.wait_for_workers(1, timeout=PATIENCE_S)
    except TimeoutError:
        raise ChannelError(f"scheduler {address} has no workers: start one with `dask worker {address}`") from None
    found: dict[str, int] = client.ncores()
    return found


def _look(client: Any, address: str) -> None:
    if client.status != "running":
        raise ChannelError(f"scheduler {address} is gone: what is done is kept; {CURE}; then the same command goes on")
    _workers(client, address)
