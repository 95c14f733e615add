"""The work on one run for a data set, as a worker performs it: extract, cut out, encode."""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from vaoi_station.model import Status
from vaoi_station.plant.archive import Archive
from vaoi_station.plant.archive.manifest import ArchivedRun
from vaoi_station.plant.datasets.crops import Crop, CropOptions, crops_of
from vaoi_station.plant.workers.run_work import Outcome, perform


@dataclass(frozen=True)
class CropTask:
    """One run whose components are cut out: archive, key and digest of its manifest. It is sent to a worker."""

    archive: str
    key: str
    manifest: str
    number: int
    """Place of the run in the data set, from 0."""
    software: str
    crops: CropOptions
    verdicts: tuple[Status, ...]


class RunCrops(NamedTuple):
    """What becomes of one run."""

    board: str
    """What stands for its board."""
    crops: tuple[Crop, ...] | None
    """None: the run has another verdict than those that are asked for."""


def crop_run(task: CropTask) -> Outcome:
    """Cut the components of one run out: all of them or none.

    A data set with a part of a run would depend on where it failed.

    Raises:
        StateError: this process has another software than the task states.
        DeviceError: storage or disk do not answer. Another attempt may succeed.
    """
    return perform(task, lambda archive, run, scratch: pickle.dumps(_cut(archive, run, scratch, task)))


def crops_from(content: bytes) -> RunCrops:
    """Return what `crop_run` has packed. It comes from a worker of the same software, by a connection of Dask."""
    unpacked: RunCrops = pickle.loads(content)
    return unpacked


def _cut(archive: Archive, run: ArchivedRun, scratch: Path, task: CropTask) -> RunCrops:
    if run.verdict not in task.verdicts:
        return RunCrops(board_key(run), None)
    folder = archive.extract(run, scratch / "run")
    return RunCrops(board_key(run), tuple(crops_of(run, folder, task.crops)))


def board_key(run: ArchivedRun) -> str:
    """Return what stands for the board of a run: its id, also at other stations; without one, the run itself."""
    return f"board {run.serial}" if run.serial else f"run {run.station}/{run.run}"
