"""The processes of a Dask cluster as an executor, for jobs that one machine takes too long for."""

import contextlib
import hashlib
import secrets
from collections.abc import Callable, Generator
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any, cast

from gpgrad_core.errors import InputError
from gpgrad_core.libraries import load_library
from gpgrad_core.run.store import code_version

ANSWER_WITHIN = 10.0
"""Time within which the scheduler must answer [s]."""
RETRIES = 3
"""How often a job is done again if it fails for a reason of the cluster's."""


class Cluster(Executor):
    """All workers of a Dask cluster.

    Dask gives the jobs of a worker that dies to another one.

    Attributes:
        num_workers: Number of jobs that the cluster does at a time.
    """

    def __init__(self, client: Any) -> None:
        """Take the workers of a client.

        Args:
            client: A Dask client that is connected.
        """
        self._client = client
        self._executor: Executor = client.get_executor(pure=False, retries=RETRIES)
        self.num_workers = sum(cast("dict[str, int]", client.nthreads()).values())

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Give a job to the cluster."""
        return self._executor.submit(fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait for the jobs, or drop them."""
        self._executor.shutdown(wait=wait and not cancel_futures)

    def sees(self, path: Path) -> bool:
        """Tell whether all workers see the same file, or the same folder, under the same name.

        Args:
            path: A file, whose content is compared, or a folder, in which a file is made for the
                moment.
        """
        if not path.is_dir():
            return self._all_have(path)
        mark = path / f".gpgrad-{secrets.token_hex(8)}"
        try:
            mark.write_text(mark.name)
            return self._all_have(mark)
        except OSError:
            return False
        finally:
            mark.unlink(missing_ok=True)

    def _all_have(self, file: Path) -> bool:
        here = _hash(file)
        there = cast("dict[str, str]", self._client.run(_hash, file.absolute()))
        return here != "" and set(there.values()) == {here}


def _hash(file: Path) -> str:
    """Compute the hash of a file; an empty text if there is none."""
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError:
        return ""


@contextlib.contextmanager
def connected(address: str) -> Generator[Cluster]:
    """Connect to a Dask scheduler for the time of a ``with`` block.

    Args:
        address: Address of the scheduler, such as ``tcp://10.0.0.7:8786``.

    Raises:
        InputError: If Dask is not installed, if no scheduler answers there, if it has no workers,
            or if a worker has another version of gpgrad or of a library under it.
        OSError: If the cluster is lost, or a job has ended several workers.
    """
    distributed = load_library("distributed", "gpgrad[cluster]")
    try:
        client = distributed.Client(address, timeout=ANSWER_WITHIN, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers there ({_one_line(error)}); start "
            "one with: dask scheduler"
        ) from None
    try:
        if not client.nthreads():
            raise InputError(
                f"--scheduler {address}: has no workers; start some with: dask worker {address}"
            )
        _check_versions(client, address)
        yield Cluster(client)
    except distributed.KilledWorker as error:
        raise OSError(
            "a job has ended several workers of the cluster, perhaps because their memory did not "
            f"suffice: {_one_line(error)}"
        ) from error
    except distributed.comm.core.CommClosedError as error:
        raise OSError(f"the cluster was lost: {_one_line(error)}") from error
    finally:
        client.close()


def _check_versions(client: Any, address: str) -> None:
    try:
        versions = cast("dict[str, str]", client.run(code_version))
    except ModuleNotFoundError as error:
        raise InputError(
            f"--scheduler {address}: its workers have no {error.name}; install gpgrad there"
        ) from None
    for worker, version in sorted(versions.items()):
        if version != code_version():
            raise InputError(
                f"--scheduler {address}: worker {worker} has another gpgrad, or another release of "
                "a library; install the same ones there as here"
            )


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
