"""A whole data set: nothing lost, nothing twice, the same bytes, no board in two splits."""

from __future__ import annotations

import json
import re
import shutil
import tarfile
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from vaoi_station.errors import DeviceError, InputError, NotFoundError
from vaoi_station.model import Status
from vaoi_station.plant.archive import Archive, RunSelection
from vaoi_station.plant.archive.catalogue import read_manifest
from vaoi_station.plant.archive.manifest import ArchivedRun
from vaoi_station.plant.archive.storage import Storage
from vaoi_station.plant.datasets import CropOptions, DatasetTerms, Listener, Splits, write_dataset
from vaoi_station.plant.workers import ClusterOptions, run_work

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


def test_a_run_that_workers_cannot_read_is_left_out_by_itself(
    boards: Archive, cluster: ClusterOptions, tmp_path: Path
) -> None:
    copied = with_a_damaged_run(boards, tmp_path)
    summary = write_dataset([copied.url], DatasetTerms(SPLITS, CROPS), tmp_path / "a", cluster)
    assert write_dataset([copied.url], DatasetTerms(SPLITS, CROPS), tmp_path / "b") == summary
    assert contents(tmp_path / "a") == contents(tmp_path / "b")
    assert (summary.runs, len(summary.left_out)) == (3, 1)


def test_no_board_is_in_two_splits(boards: Archive, tmp_path: Path) -> None:
    write_dataset([boards.url], DatasetTerms(SPLITS, CROPS), tmp_path / "a")
    splits = {(i["board_id"], i["split"]) for i in coco(tmp_path / "a")}
    assert len(splits) == 4
    assert {split for _, split in splits} == {"train", "val"}


def test_other_verdicts_come_with_their_verdict_if_asked_for(boards: Archive, tmp_path: Path) -> None:
    chosen = RunSelection(station="line 9")
    terms = DatasetTerms(SPLITS, CROPS, chosen, (Status.OK, Status.DEGRADED))
    assert write_dataset([boards.url], terms, tmp_path / "a").runs == 1
    assert {i["verdict"] for i in coco(tmp_path / "a")} == {"degraded"}


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

    monkeypatch.setattr(run_work, "read_manifest", read)
    summary = write_dataset([boards.url], DatasetTerms(SPLITS, CropOptions(("R1",))), tmp_path / "a")
    assert summary.runs == 2
    assert sorted(text.partition(".")[0] for text in summary.left_out) == [
        "r3 was removed meanwhile",
        "the archive does not answer",
    ]
