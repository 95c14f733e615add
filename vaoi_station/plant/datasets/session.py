"""One call of `vaoi dataset`: the selected runs, in their order, into one data set."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

from vaoi_station.errors import DeviceError
from vaoi_station.files.atomic_directory import new_directory, refuse_existing
from vaoi_station.model import Status
from vaoi_station.plant.archive import RunSelection
from vaoi_station.plant.datasets.coco import CocoWriter
from vaoi_station.plant.datasets.crop_task import CropTask, crop_run, crops_from
from vaoi_station.plant.datasets.crops import CropOptions
from vaoi_station.plant.datasets.in_order import InOrder
from vaoi_station.plant.datasets.splits import Splits
from vaoi_station.plant.datasets.webdataset import WebDatasetWriter
from vaoi_station.plant.selected_runs import SelectedRuns
from vaoi_station.plant.workers import ClusterOptions, Dispatch, cluster_address, dashboard_link
from vaoi_station.plant.workers.software import software

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
class Listener:
    """Receives the numbers of done runs and of all, as far as it is known, sentences on faults, and other ones."""

    progress: Callable[[int, int], None] = lambda _done, _runs: None
    report: Callable[[str], None] = lambda _text: None
    inform: Callable[[str], None] = lambda _text: None


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
    cluster: ClusterOptions | None = None,
    listener: Listener | None = None,
) -> DatasetSummary:
    """Write the crops of all selected runs to a new directory, which is complete or not there.

    Args:
        archives: their addresses.
        terms: what the data set is made of. Equal ones give equal bytes, also on clusters of different sizes.
        out: the directory.
        cluster: where components are cut out; None: in this process, one run after the other.
        listener: what receives progress and faults.

    Raises:
        InputError: the directory exists, or an archive cannot be opened.
        StateError: scheduler or workers do not answer.
    """
    refuse_existing(out)
    listener = listener or Listener()
    if cluster is not None:
        cluster.check()
    left_out: list[str] = []

    def leave_out(text: str) -> None:
        left_out.append(text)
        listener.report(text)

    selected = SelectedRuns(archives, terms.selection, leave_out)
    own = software()
    tasks = (CropTask(*run, number, own, terms.crops, terms.verdicts) for number, run in enumerate(selected))
    names = [name for name, _ in terms.splits.shares]
    counts, tally = dict.fromkeys(names, 0), Counter[str]()
    with (
        tempfile.TemporaryDirectory(prefix="vaoi-crops-") as early,
        new_directory(out) as draft,
        FORMATS[terms.format](draft, names, terms.document()) as writer,
    ):

        def take(content: bytes) -> None:
            board, crops = crops_from(content)
            tally["other" if crops is None else "runs"] += 1
            split = terms.splits.of_board(board)
            for crop in crops or ():
                writer.add(split, crop)
                counts[split] += 1
                tally["empty"] += crop.outline_px is None

        ordered = InOrder(Path(early), take)
        done = 0
        listener.progress(0, selected.runs)

        def keep(task: CropTask, content: bytes | None) -> None:
            nonlocal done
            ordered.put(task.number, content)
            done += 1
            listener.progress(done, selected.runs)

        def give_up(task: CropTask, text: str) -> None:
            leave_out(text)
            keep(task, None)

        if cluster is None:
            _work_here(tasks, keep, give_up)
        elif (first := next(tasks, None)) is not None:
            with cluster_address(cluster) as address:
                if link := dashboard_link(address, cluster.patience_s):
                    listener.inform(f"dashboard: {link}")
                dispatch = Dispatch(own, crop_run, keep, give_up, listener.report)
                dispatch.work(address, chain((first,), tasks), selected.archives, cluster.patience_s)
            left_out += dispatch.refused_workers
        listener.progress(done, selected.runs)
    return DatasetSummary(tally["runs"], counts, tally["empty"], tally["other"], tuple(left_out))


def _work_here(
    tasks: Iterable[CropTask], keep: Callable[[CropTask, bytes], None], give_up: Callable[[CropTask, str], None]
) -> None:
    for task in tasks:
        try:
            outcome = crop_run(task)
        except DeviceError as error:
            give_up(task, str(error))
            continue
        if isinstance(outcome, bytes):
            keep(task, outcome)
        else:
            give_up(task, outcome.message)
