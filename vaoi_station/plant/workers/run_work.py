"""What tasks on archived runs have in common, as a worker performs them."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from vaoi_station.errors import DeviceError, InputError, NotFoundError, StateError
from vaoi_station.plant.archive import Archive
from vaoi_station.plant.archive.catalogue import read_manifest
from vaoi_station.plant.archive.manifest import ArchivedRun
from vaoi_station.plant.workers.software import software


class ArchivedTask(Protocol):
    """A task on one run. It is sent to a worker."""

    @property
    def archive(self) -> str:
        """Address of the archive."""

    @property
    def key(self) -> str:
        """Key of the run's manifest."""

    @property
    def manifest(self) -> str:
        """Digest of the manifest when the run was selected."""

    @property
    def software(self) -> str:
        """Software that the worker must have."""


@dataclass(frozen=True)
class RunFault:
    """A run on which no worker can perform the task."""

    message: str


@dataclass(frozen=True)
class UnseenArchive:
    """A worker that does not see the archive of a run: another one may."""

    message: str
    worker: str
    """Address of the worker; empty outside of one."""


Outcome = bytes | RunFault | UnseenArchive
"""What a worker returns: the content that the task yields, or why there is none."""


def perform(task: ArchivedTask, work: Callable[[Archive, ArchivedRun, Path], bytes]) -> Outcome:
    """Perform a task: `work` gets the archive, the run and an empty directory, which is removed afterwards.

    Raises:
        StateError: this process has another software than the task states.
        DeviceError: storage or disk do not answer. Another attempt may succeed.
    """
    if software() != task.software:
        raise StateError(f"This worker has {software()}, but must have {task.software}.")
    try:
        if task.archive not in _OPENED:
            _OPENED[task.archive] = Archive.open(task.archive)
        archive = _OPENED[task.archive]
        run = read_manifest(archive.storage, task.key)
        if run.digest != task.manifest:
            raise InputError(
                f"{archive.url}/{task.key}: was replaced after the run was selected.", action="Repeat the command."
            )
        with tempfile.TemporaryDirectory(prefix="run-", dir=_worker("local_directory")) as scratch:
            return work(archive, run, Path(scratch))
    except (InputError, NotFoundError, StateError) as error:
        # A value, not an exception: Dask would repeat the task, with the same outcome.
        return _unseen(task.archive) or RunFault(str(error))
    except DeviceError:
        _OPENED.pop(task.archive, None)
        raise


_OPENED: dict[str, Archive] = {}
"""The archives that this process has opened: to open an object store takes almost as long as to stitch a run."""


def _unseen(url: str) -> UnseenArchive | None:
    """Return whether it is the archive that this process does not see, for example because a share is not mounted."""
    try:
        Archive.open(url)
    except InputError as error:
        _OPENED.pop(url, None)
        return UnseenArchive(str(error), _worker("address") or "")
    return None


def _worker(name: str) -> str | None:
    """Return the address or the directory of this worker; Dask removes the directory also after a kill.

    Outside of a worker there is neither.
    """
    with suppress(ImportError, ValueError):
        from distributed import get_worker

        return str(getattr(get_worker(), name))
    return None
