"""One call of `vaoi dataset`: the selected runs, one after the other, into one data set."""

from __future__ import annotations

import pickle
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from vaoi_station.errors import DeviceError, InputError, NotFoundError, StateError
from vaoi_station.files.atomic_directory import new_directory, refuse_existing
from vaoi_station.model import Status
from vaoi_station.plant.archive import Archive, RunSelection
from vaoi_station.plant.archive.catalogue import read_manifest
from vaoi_station.plant.archive.manifest import ArchivedRun
from vaoi_station.plant.datasets.coco import CocoWriter
from vaoi_station.plant.datasets.crops import Crop, CropOptions, crops_of
from vaoi_station.plant.datasets.splits import Splits
from vaoi_station.plant.datasets.webdataset import WebDatasetWriter
from vaoi_station.plant.selected_runs import select_runs

FORMATS: dict[str, type[CocoWriter | WebDatasetWriter]] = {"coco": CocoWriter, "webdataset": WebDatasetWriter}


@dataclass(frozen=True)
class DatasetTerms:
    """What a data set is made of."""

    splits: Splits
    crops: CropOptions = field(default_factory=CropOptions)
    selection: RunSelection = field(default_factory=RunSelection)
    verdicts: tuple[Status, ...] = (Status.OK,)
    """Runs with another verdict, or without a result, are left out."""
    format: str = "coco"

    def document(self) -> dict[str, Any]:
        """Return the terms as JSON values. They name no time and no place: equal terms give equal bytes."""
        return {
            "description": "Crops of components, by vaoi dataset",
            "components": list(self.crops.components),
            "images": self.crops.images.options(),
            "selection": {name: value for name, value in vars(self.selection).items() if value is not None},
            "verdicts": [str(verdict) for verdict in self.verdicts],
            "splits": dict(self.splits.shares),
        }


@dataclass(frozen=True)
class DatasetSummary:
    """How a call ended."""

    runs: int
    """Number of runs whose crops are in the data set."""
    crops: dict[str, int]
    """Number of crops by split."""
    empty: int
    """Number of crops without a component."""
    other_verdicts: int
    """Number of runs that were left out by their verdict."""
    left_out: tuple[str, ...]
    """Runs that could not be used, and why."""


def write_dataset(
    archives: Sequence[str],
    terms: DatasetTerms,
    out: Path,
    progress: Callable[[int, int], None] = lambda _done, _runs: None,
    report: Callable[[str], None] = lambda _text: None,
) -> DatasetSummary:
    """Write the crops of all selected runs to a new directory, which is complete or not there.

    Raises:
        InputError: the directory exists, or an archive cannot be opened.
    """
    refuse_existing(out)
    left_out: list[str] = []

    def leave_out(text: str) -> None:
        left_out.append(text)
        report(text)

    chosen = select_runs(archives, terms.selection, leave_out)
    names = [name for name, _ in terms.splits.shares]
    counts = dict.fromkeys(names, 0)
    tally = Counter[str]()
    opened: dict[str, Archive] = {}
    with new_directory(out) as draft, FORMATS[terms.format](draft, names, terms.document()) as writer:
        for done, (url, key, _) in enumerate(chosen):
            progress(done, len(chosen))
            with tempfile.TemporaryDirectory(prefix="vaoi-crops-") as scratch:
                spool = Path(scratch) / "crops"
                try:
                    if url not in opened:
                        opened[url] = Archive.open(url)
                    archive = opened[url]
                    run = read_manifest(archive.storage, key)
                    if run.verdict not in terms.verdicts:
                        tally["other"] += 1
                        continue
                    folder = archive.extract(run, Path(scratch) / "run")
                    # All crops of a run or none: a data set with a part of a run would depend on where it failed.
                    number = _write_spool(spool, crops_of(run, folder, terms.crops))
                except (DeviceError, InputError, NotFoundError, StateError) as error:
                    leave_out(str(error))
                    continue
                split = terms.splits.of_board(board_key(run))
                tally["runs"] += 1
                for crop in _read_spool(spool, number):
                    writer.add(split, crop)
                    counts[split] += 1
                    tally["empty"] += crop.outline_px is None
        progress(len(chosen), len(chosen))
    return DatasetSummary(tally["runs"], counts, tally["empty"], tally["other"], tuple(left_out))


def board_key(run: ArchivedRun) -> str:
    """Return what stands for the board of a run: its id, also at other stations; without one, the run itself."""
    return f"board {run.serial}" if run.serial else f"run {run.station}/{run.run}"


def _write_spool(path: Path, crops: Iterable[Crop]) -> int:
    """Write crops to a temporary file, as those of a run may be more than fit into memory; return their number."""
    number = 0
    with path.open("wb") as file:
        for crop in crops:
            pickle.dump(crop, file)
            number += 1
    return number


def _read_spool(path: Path, number: int) -> Iterator[Crop]:
    with path.open("rb") as file:
        for _ in range(number):
            yield pickle.load(file)
