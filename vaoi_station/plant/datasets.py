"""`vaoi dataset`: crops of components of archived runs as COCO or WebDataset, split by board."""

from __future__ import annotations

import io
import json
import pickle
import tarfile
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from hashlib import sha256
from itertools import chain
from pathlib import Path
from types import TracebackType
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import DeviceError, InputError, StateError
from vaoi_station.files import open_recording, read_board_type, read_calibration, read_stitch
from vaoi_station.files.directories import new_directory, refuse_existing
from vaoi_station.files.documents import write_json
from vaoi_station.files.images import decode, encode_png
from vaoi_station.geometry import apply
from vaoi_station.model import BoardType, Component, Status, Stitch
from vaoi_station.plant.archive import Archive, RunSelection
from vaoi_station.plant.cluster import (
    ClusterOptions,
    Dispatch,
    Outcome,
    cluster_address,
    dashboard_link,
    perform,
    software,
)
from vaoi_station.plant.manifest import ArchivedRun, matches
from vaoi_station.plant.selected_runs import SelectedRuns
from vaoi_station.rendering import ChosenImages, ChosenView, ImageRequest, ViewCalculator, choose_all, measure
from vaoi_station.rendering.selection import component_covariances, describe, frame_facts, render_chosen

UNKNOWN = "unknown"


@dataclass(frozen=True)
class CropOptions:
    """Which components are cut out, and which of their pictures."""

    components: tuple[str, ...] = ("*",)
    """References or addresses, or patterns of them with * and ?."""
    images: ImageRequest = field(default_factory=ImageRequest)

    def admits(self, part: Component) -> bool:
        """Return whether a component is wanted."""
        names = (part.ref, part.address)
        return any(matches(name, wanted) for wanted in self.components for name in names)


@dataclass(frozen=True, eq=False)
class Crop:
    """One picture of a component."""

    png: bytes
    facts: dict[str, Any]
    """Everything that is known about it, as JSON values; docs/plant.md lists them."""
    outline_px: NDArray[np.float64] | None
    """Corners (4, 2) of the footprint, px from the upper left corner of the crop; None: no component is there."""

    @property
    def pixels(self) -> NDArray[Any]:
        """Pixels (height, width) or (height, width, 3) blue-green-red."""
        image = decode(self.png)
        assert image is not None  # encoded by this software
        return image

    @property
    def category(self) -> str:
        """Package of the component."""
        return str(self.facts["package"] or UNKNOWN)


def crops_of(run: ArchivedRun, folder: Path, options: CropOptions) -> Iterator[Crop]:
    """Yield the crops of an extracted run, ordered by frame and by component as the board type has them.

    InputError or StateError says why the run has none: a damaged document, another light, no CAD mapping.
    """
    recording = open_recording(folder)
    head = recording.head
    board_type, result = read_board_type(folder / "board.json"), read_stitch(folder / "result.json")
    if result.cad_matrix is None:
        raise StateError(f"run {run.run}: its result has no CAD mapping.", action="Leave out runs that failed.")
    parts = [part for part in board_type.components if options.admits(part)]
    cameras = read_calibration(folder / "calibration.json", head.cameras).cameras(head.cameras)
    facts = frame_facts(head)

    def pixels(camera: int, row: int) -> NDArray[Any]:
        frame = recording.frame(camera, row)
        assert frame is not None  # views of missing frames are left out
        return frame

    chosen = choose_all(
        ViewCalculator(board_type, result, cameras),
        parts,
        (board_type, result),
        (set(facts) - set(head.missing), facts),
        options.images,
        lambda view: measure(view, pixels(view.camera, view.row)),
    )
    by_frame: dict[tuple[int, int], list[tuple[ChosenImages, ChosenView]]] = defaultdict(list)
    for images in chosen:
        for choice in images.chosen:
            by_frame[choice.view.camera, choice.view.row].append((images, choice))
    for at in sorted(by_frame):
        frame = pixels(*at)
        for images, choice in by_frame[at]:
            yield Crop(
                encode_png(render_chosen(choice, frame)),
                _facts(run, board_type, result, images, choice),
                _outline(board_type, images.part, choice),
            )


def _outline(board_type: BoardType, part: Component, choice: ChosenView) -> NDArray[np.float64] | None:
    if part.fitted is False:
        return None
    # From the centre of the first pixel, as in all pictures of the station, to its corner, as in COCO.
    return np.asarray(apply(choice.view.crop_matrix, board_type.footprint(part)) + 0.5)


def _facts(
    run: ArchivedRun, board_type: BoardType, result: Stitch, images: ChosenImages, choice: ChosenView
) -> dict[str, Any]:
    part, view = images.part, choice.view
    covariance = component_covariances(result, part.address).get((view.camera, view.row))
    known = describe(choice, images.covariance_px2(choice, covariance))
    heights, sigmas = result.quality.get("heights_mm"), result.quality.get("height_sigma_mm")
    return {
        "station": run.station,
        "run": run.run,
        "time": run.time,
        "board_type": run.board_type,
        "revision": run.revision,
        "board_id": run.serial,
        "verdict": str(run.verdict or result.status),
        "component": part.address,
        "reference": part.ref,
        "panel": part.panel,
        "package": part.package,
        "fitted": part.fitted,
        "side": board_type.side,
        "rotation_deg": part.rotation,
        "body_height_mm": heights.get(part.address) if isinstance(heights, dict) else None,
        "body_height_sigma_mm": sigmas.get(part.address) if isinstance(sigmas, dict) else None,
        **{name: known[name] for name in _OF_THE_PICTURE},
    }


_OF_THE_PICTURE = (
    "camera", "row", "light", "exposure_us", "gain", "time_s", "sigma_px", "sigma_mm", "coverage", "px_per_mm",
    "view_azimuth_deg", "view_angle_deg", "width_px", "height_px", "crop_from_cad",
)  # fmt: skip


_LISTS = ("images", "annotations")


class CocoWriter:
    """A data set in COCO format, within a directory that the caller completes.

    A crop of a place without a component is an image without an annotation, as COCO has it for empty images.
    """

    def __init__(self, directory: Path, splits: Sequence[str], info: dict[str, Any]) -> None:
        self._directory, self._info = directory, info
        self._stack = ExitStack()
        self._lists: dict[tuple[str, str], IO[str]] = {}
        self._images = self._annotations = 0
        self._begun = set[tuple[str, str]]()
        self._categories: dict[str, int] = {}
        (directory / "annotations").mkdir()
        for split in splits:
            (directory / split).mkdir()
            for name in _LISTS:
                path = directory / f".{split}.{name}"
                self._lists[split, name] = self._stack.enter_context(path.open("w+", encoding="utf-8"))
        self._splits = tuple(splits)

    def __enter__(self) -> CocoWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._stack:
            if kind is None:
                for split in self._splits:
                    self._finish(split)
        for split, name in self._lists:
            (self._directory / f".{split}.{name}").unlink()

    def add(self, split: str, crop: Crop) -> None:
        """Write a crop."""
        self._images += 1
        # References may contain any characters: files have numbers, and the entry has the reference unchanged.
        name = f"{self._images:09d}.png"
        (self._directory / split / name).write_bytes(crop.png)
        width, height = crop.facts["width_px"], crop.facts["height_px"]
        image = {"id": self._images, "file_name": name, "width": width, "height": height, "attributes": crop.facts}
        self._list(split, "images", image)
        if crop.outline_px is None:
            return
        category = self._categories.setdefault(crop.category, len(self._categories) + 1)
        self._annotations += 1
        annotation = {"id": self._annotations, "image_id": self._images, "category_id": category, "iscrowd": 0}
        self._list(split, "annotations", annotation | outline_document(crop))

    def _list(self, split: str, name: str, entry: dict[str, Any]) -> None:
        file = self._lists[split, name]
        file.write(
            (",\n" if (split, name) in self._begun else "") + json.dumps(entry, ensure_ascii=False, allow_nan=False)
        )
        self._begun.add((split, name))

    def _finish(self, split: str) -> None:
        path = self._directory / "annotations" / f"instances_{split}.json"
        categories = [{"id": number, "name": name} for name, number in self._categories.items()]
        with path.open("w", encoding="utf-8") as file:
            file.write('{"info": ' + json.dumps(self._info, ensure_ascii=False))
            file.write(',\n"categories": ' + json.dumps(categories, ensure_ascii=False))
            for name in _LISTS:
                source = self._lists[split, name]
                source.seek(0)
                file.write(f',\n"{name}": [\n')
                while chunk := source.read(1 << 20):
                    file.write(chunk)
                file.write("\n]")
            file.write("}\n")


def outline_document(crop: Crop) -> dict[str, Any]:
    """Return box, area and polygon of the component within a crop, as COCO has them: px from the upper left corner."""
    outline = crop.outline_px
    assert outline is not None  # checked by the caller
    low, size = outline.min(0), outline.max(0) - outline.min(0)
    x, y = outline.T
    area = abs(float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())) / 2
    corners = [round(float(v), 3) for v in outline.ravel()]
    box = [round(float(v), 3) for v in (*low, *size)]
    return {"bbox": box, "area": round(area, 3), "segmentation": [corners]}


SAMPLES = 2000


class WebDatasetWriter:
    """A data set of `SPLIT-NNNNNN.tar` files, within a directory that the caller completes.

    The JSON of a sample has the facts of the crop, its category, and the outline of the component; the outline is null
    where there is no component.
    """

    def __init__(self, directory: Path, splits: Sequence[str], info: dict[str, Any], samples: int = SAMPLES) -> None:
        self._directory, self._samples, self._info = directory, samples, info
        self._counts = dict.fromkeys(splits, 0)
        self._shards: dict[str, tarfile.TarFile] = {}

    def __enter__(self) -> WebDatasetWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for shard in self._shards.values():
            shard.close()
        if kind is None:
            write_json(self._directory / "dataset.json", {"info": self._info, "samples": self._counts})

    def add(self, split: str, crop: Crop) -> None:
        """Write a crop."""
        number = self._counts[split]
        self._counts[split] += 1
        if number % self._samples == 0:
            if split in self._shards:
                self._shards[split].close()
            path = self._directory / f"{split}-{number // self._samples:06d}.tar"
            self._shards[split] = tarfile.open(path, "w", format=tarfile.USTAR_FORMAT)  # noqa: SIM115  (closed above)
        # A key ends at its first dot, so it is a number; the JSON has all names unchanged.
        key = f"{number:09d}"
        outline = None if crop.outline_px is None else outline_document(crop)
        facts = {**crop.facts, "category": crop.category, "outline": outline}
        text = json.dumps(facts, ensure_ascii=False, allow_nan=False).encode()
        for suffix, content in (("png", crop.png), ("json", text)):
            # Neither time nor owner: equal crops give equal bytes.
            member = tarfile.TarInfo(f"{key}.{suffix}")
            member.size, member.mode = len(content), 0o644
            self._shards[split].addfile(member, io.BytesIO(content))


DEFAULT = "train=0.8,val=0.1,test=0.1"
RESERVED = "annotations"


@dataclass(frozen=True)
class Splits:
    """Names of the splits, with the share of the boards that each gets."""

    shares: tuple[tuple[str, float], ...]

    @staticmethod
    def of(text: str) -> Splits:
        """Parse `train=0.8,val=0.1,test=0.1`. Raise InputError unless the shares are positive and add up to 1."""
        pairs = [part.partition("=") for part in text.split(",")]
        try:
            shares = tuple((name.strip(), float(share)) for name, _, share in pairs)
        except ValueError:
            shares = ()
        names = [name for name, _ in shares]
        usable = all(name.isidentifier() for name in names) and len(set(names)) == len(names)
        if not shares or not usable or not all(0 < share <= 1 for _, share in shares):
            raise InputError.field("vaoi dataset", "--splits", text, f"names with shares, such as {DEFAULT}")
        if RESERVED in names:
            raise InputError.field(
                "vaoi dataset", "--splits", text, f"names other than {RESERVED}, a directory of COCO"
            )
        if abs(sum(share for _, share in shares) - 1) > 1e-9:
            raise InputError.field("vaoi dataset", "--splits", text, "shares that add up to 1")
        return Splits(shares)

    def of_board(self, board: str) -> str:
        """Return the split of a board."""
        at = int.from_bytes(sha256(board.encode()).digest()[:8], "big") / 2**64
        for name, share in self.shares:
            if at < share:
                return name
            at -= share
        return self.shares[-1][0]  # shares of floating-point numbers may add up to a little less than 1


class InOrder:
    """Gives the outcome of each run to `take` when those of all runs before it have come.

    What comes early waits in files: a run that is tried again may keep many others waiting.
    """

    def __init__(self, folder: Path, take: Callable[[bytes], None]) -> None:
        self._folder, self._take = folder, take
        self._next = 0
        self._early: dict[int, Path | bytes | None] = {}

    def put(self, number: int, content: bytes | None) -> None:
        """Receive the outcome of a run by its number; None: the run is left out."""
        self._early[number] = content if number == self._next else self._stored(number, content)
        while self._next in self._early:
            outcome = self._early.pop(self._next)
            self._next += 1
            if isinstance(outcome, Path):
                path, outcome = outcome, outcome.read_bytes()
                path.unlink()
            if outcome is not None:
                self._take(outcome)

    def _stored(self, number: int, content: bytes | None) -> Path | None:
        if content is None:
            return None
        path = self._folder / str(number)
        path.write_bytes(content)
        return path


@dataclass(frozen=True)
class CropTask:
    """One run whose components are cut out: archive, key and digest of its manifest. It is sent to a worker."""

    archive: str
    key: str
    manifest: str
    number: int
    software: str
    crops: CropOptions
    verdicts: tuple[Status, ...]


class RunCrops(NamedTuple):
    """What becomes of one run."""

    board: str
    crops: tuple[Crop, ...] | None
    """None: the run has another verdict than those that are asked for."""


def crop_run(task: CropTask) -> Outcome:
    """Cut the components of one run out, all of them or none: a part would depend on where it failed."""
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
    crops: dict[str, int]
    empty: int
    other_verdicts: int
    left_out: tuple[str, ...]


def write_dataset(
    archives: Sequence[str],
    terms: DatasetTerms,
    out: Path,
    cluster: ClusterOptions | None = None,
    listener: Listener | None = None,
) -> DatasetSummary:
    """Write the crops of all selected runs to a new directory, which is complete or not there.

    Equal terms give equal bytes, also on clusters of different sizes. Without a cluster this process does the work.
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
