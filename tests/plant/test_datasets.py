"""Crops of archived runs as data sets."""

from __future__ import annotations

import json
import re
import shutil
import tarfile
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station import StitchedRun
from vaoi_station.errors import DeviceError, InputError, NotFoundError
from vaoi_station.files.images import encode_png, read_image
from vaoi_station.model import Status
from vaoi_station.plant import cluster
from vaoi_station.plant.archive import Archive
from vaoi_station.plant.catalogue import read_manifest
from vaoi_station.plant.cluster import ClusterOptions, RunFault, software
from vaoi_station.plant.datasets import (
    DEFAULT,
    CocoWriter,
    Crop,
    CropOptions,
    CropTask,
    DatasetTerms,
    Listener,
    Splits,
    crop_run,
    crops_of,
    write_dataset,
)
from vaoi_station.plant.manifest import ArchivedRun
from vaoi_station.plant.storage import Storage


def test_boards_are_shared_out_as_stated() -> None:
    splits = Splits.of(DEFAULT)
    counts = Counter(splits.of_board(f"board {n}") for n in range(4000))
    assert counts["train"] == pytest.approx(3200, abs=100)
    assert counts["val"] == pytest.approx(400, abs=70)
    assert {splits.of_board("board 7") for _ in range(3)} == {Splits.of(DEFAULT).of_board("board 7")}


@pytest.fixture(scope="module")
def crops(boards: Archive, tmp_path_factory: pytest.TempPathFactory) -> list[Crop]:
    run = boards.run("r1")
    folder = boards.extract(run, tmp_path_factory.mktemp("crops") / "run")
    return list(crops_of(run, folder, CropOptions(("U*", "R1"))))


def test_crops_are_those_of_the_library(crops: list[Crop], stitched: StitchedRun) -> None:
    images = {(i.camera, i.row): i for i in stitched.component("U1")}
    mine = {(c.facts["camera"], c.facts["row"]): c for c in crops if c.facts["component"] == "U1"}
    assert set(mine) == set(images)
    for at, crop in mine.items():
        assert np.array_equal(crop.pixels, images[at].pixels)
        assert crop.facts["sigma_px"] == images[at].sigma_px
        assert crop.facts["exposure_us"] == images[at].exposure_us


def test_the_outline_is_counted_from_the_corner_of_the_crop(crops: list[Crop]) -> None:
    crop = next(c for c in crops if c.facts["component"] == "U1")
    assert crop.outline_px is not None
    height, width = crop.pixels.shape[:2]
    # Without a margin the crop is the box of the footprint, rounded up to whole pixels.
    assert crop.outline_px.min(0) == pytest.approx([0, 0], abs=1.01)
    assert crop.outline_px.max(0) == pytest.approx([width, height], abs=1.01)


def task_of(archive: Archive, run: str) -> CropTask:
    found = archive.run(run)
    return CropTask(archive.url, found.key, found.digest, 0, software(), CropOptions(("U1",)), (Status.OK,))


def test_what_cannot_be_done_is_named(boards: Archive) -> None:
    task = task_of(boards, "r1")
    replaced = crop_run(replace(task, manifest="0" * 16))
    assert isinstance(replaced, RunFault)
    assert "was replaced after the run was selected" in replaced.message
    assert "but must have vaoi_station 0" in str(crop_run(replace(task, software="vaoi_station 0")))


NAME = '2/R1.0 µ"x'


def crop(outline: Any, package: str | None = "0402") -> Crop:
    pixels = np.arange(12, dtype=np.uint8).reshape(3, 4)
    facts = {"component": NAME, "package": package, "width_px": 4, "height_px": 3}
    return Crop(encode_png(pixels), facts, None if outline is None else np.array(outline))


def test_images_annotations_and_categories(tmp_path: Path) -> None:
    square = [[1.0, 0.0], [3.0, 0.0], [3.0, 2.5], [1.0, 2.5]]
    with CocoWriter(tmp_path, ["train", "val"], {"description": "d"}) as writer:
        writer.add("train", crop(square))
        writer.add("train", crop(None))
        writer.add("val", crop(square, None))
    train = json.loads((tmp_path / "annotations" / "instances_train.json").read_text(encoding="utf-8"))
    assert [i["id"] for i in train["images"]] == [1, 2]
    assert [a["image_id"] for a in train["annotations"]] == [1], "the empty image is kept without an annotation"
    assert train["images"][1]["attributes"]["component"] == NAME, "nothing is renamed"
    note = train["annotations"][0]
    assert note["bbox"] == [1, 0, 2, 2.5]
    assert note["area"] == 5
    assert note["segmentation"] == [[1, 0, 3, 0, 3, 2.5, 1, 2.5]]
    val = json.loads((tmp_path / "annotations" / "instances_val.json").read_text(encoding="utf-8"))
    assert val["categories"] == train["categories"] == [{"id": 1, "name": "0402"}, {"id": 2, "name": "unknown"}]
    image = tmp_path / "val" / val["images"][0]["file_name"]
    assert np.array_equal(read_image(image), crop(None).pixels)
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]


CROPS = CropOptions(("U1", "R1"))
SPLITS = Splits.of("train=0.5,val=0.5")


def contents(directory: Path) -> dict[str, bytes]:
    return {str(p.relative_to(directory)): p.read_bytes() for p in sorted(directory.rglob("*")) if p.is_file()}


def with_a_damaged_run(boards: Archive, folder: Path) -> Archive:
    """Return a copy of an archive in which a blob of run r2 is missing."""
    copied = Archive.open(shutil.copytree(boards.url, folder / "copied"))
    run = copied.run("r2")
    (folder / "copied" / run.key).write_text(
        (folder / "copied" / run.key).read_text().replace(run.frames[0].sha256, "0" * 64)
    )
    return copied


def coco(directory: Path) -> list[dict[str, Any]]:
    """Read all images of a data set, with their split and whether they have an annotation."""
    found = []
    for path in sorted((directory / "annotations").iterdir()):
        document = json.loads(path.read_text(encoding="utf-8"))
        noted = Counter(a["image_id"] for a in document["annotations"])
        split = path.stem.removeprefix("instances_")
        for image in document["images"]:
            assert (directory / split / image["file_name"]).is_file()
            found.append(image["attributes"] | {"split": split, "notes": noted[image["id"]]})
    return found


def samples(directory: Path) -> list[dict[str, Any]]:
    """Read all samples of a WebDataset in the same form."""
    found = []
    for path in sorted(directory.glob("*.tar")):
        with tarfile.open(path) as shard:
            for name in shard.getnames():
                if name.endswith(".json"):
                    sample = json.load(shard.extractfile(name))  # type: ignore[arg-type]
                    outline, _ = sample.pop("outline"), sample.pop("category")
                    found.append(sample | {"split": path.name.partition("-")[0], "notes": int(outline is not None)})
    return found


def test_both_formats_hold_the_same_and_the_bytes_repeat(boards: Archive, tmp_path: Path) -> None:
    terms = DatasetTerms(SPLITS, CROPS)
    summary = write_dataset([boards.url], terms, tmp_path / "a")
    write_dataset([boards.url, boards.url], terms, tmp_path / "b")
    assert contents(tmp_path / "a") == contents(tmp_path / "b")
    write_dataset([boards.url], DatasetTerms(SPLITS, CROPS, format="webdataset"), tmp_path / "w")
    write_dataset([boards.url], DatasetTerms(SPLITS, CROPS, format="webdataset"), tmp_path / "v")
    assert contents(tmp_path / "w") == contents(tmp_path / "v")

    def order(sample: dict[str, Any]) -> Any:
        return sample["run"], sample["camera"], sample["row"], sample["component"]

    images = coco(tmp_path / "a")
    assert sorted(images, key=order) == sorted(samples(tmp_path / "w"), key=order)
    assert len(images) == sum(summary.crops.values())
    counts = Counter((i["run"], i["component"]) for i in images)
    assert len({counts[run, ref] for run in ("r0", "r1", "r2", "r3") for ref in ("U1",)}) == 1, "no crop is lost"
    assert {i["notes"] for i in images if i["component"] == "R1"} == {0}
    assert summary.empty == sum(i["notes"] == 0 for i in images)
    assert (summary.runs, summary.other_verdicts, summary.left_out) == (4, 1, ())


@pytest.mark.parametrize("form", ["coco", "webdataset"])
def test_the_bytes_do_not_depend_on_the_number_of_workers(
    boards: Archive, cluster: ClusterOptions, tmp_path: Path, form: str
) -> None:
    terms = DatasetTerms(SPLITS, CROPS, format=form)
    informed: list[str] = []
    alone = write_dataset([boards.url], terms, tmp_path / "alone")
    shared = write_dataset([boards.url], terms, tmp_path / "shared", cluster, Listener(inform=informed.append))
    assert alone == shared
    assert contents(tmp_path / "alone") == contents(tmp_path / "shared")
    assert re.fullmatch(r"dashboard: http://127\.0\.0\.1:\d+/status", informed[0])


def test_no_board_is_in_two_splits(boards: Archive, tmp_path: Path) -> None:
    write_dataset([boards.url], DatasetTerms(SPLITS, CROPS), tmp_path / "a")
    splits = {(i["board_id"], i["split"]) for i in coco(tmp_path / "a")}
    assert len(splits) == 4
    assert {split for _, split in splits} == {"train", "val"}


def test_a_damaged_run_is_named_and_the_others_go_on(boards: Archive, tmp_path: Path) -> None:
    copied = with_a_damaged_run(boards, tmp_path)
    reported: list[str] = []
    summary = write_dataset(
        [copied.url], DatasetTerms(SPLITS, CROPS), tmp_path / "a", listener=Listener(report=reported.append)
    )
    assert summary.runs == 3
    assert list(summary.left_out) == reported
    assert "run r2: blob 0000" in reported[0]
    with pytest.raises(InputError, match="exists already"):
        write_dataset([copied.url], DatasetTerms(SPLITS, CROPS), tmp_path / "a")


def test_a_storage_that_fails_for_a_run_does_not_discard_the_others(
    boards: Archive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read(storage: Storage, key: str) -> ArchivedRun:
        if key.endswith("r0.json"):
            raise DeviceError("the archive does not answer.")
        if key.endswith("r3.json"):
            raise NotFoundError("r3 was removed meanwhile.")
        return read_manifest(storage, key)

    monkeypatch.setattr(cluster, "read_manifest", read)
    summary = write_dataset([boards.url], DatasetTerms(SPLITS, CropOptions(("R1",))), tmp_path / "a")
    assert summary.runs == 2
    assert sorted(text.partition(".")[0] for text in summary.left_out) == [
        "r3 was removed meanwhile",
        "the archive does not answer",
    ]
