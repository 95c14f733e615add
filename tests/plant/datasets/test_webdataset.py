"""WebDataset: shards of bounded length, samples of PNG and JSON, no times."""

from __future__ import annotations

import json
import tarfile
from pathlib import Path

from tests.plant.datasets.test_coco import NAME, crop
from vaoi_station.plant.datasets.webdataset import WebDatasetWriter


def test_samples_are_whole_and_shards_bounded(tmp_path: Path) -> None:
    with WebDatasetWriter(tmp_path, ["train", "val"], {"a": 1}, samples=2) as writer:
        for outline in ([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], None, None):
            writer.add("train", crop(outline))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["dataset.json", "train-000000.tar", "train-000001.tar"]
    with tarfile.open(tmp_path / "train-000000.tar") as shard:
        assert shard.getnames() == ["000000000.png", "000000000.json", "000000001.png", "000000001.json"]
        assert {(m.mtime, m.uid, m.uname) for m in shard} == {(0, 0, "")}
        samples = [json.load(shard.extractfile(n)) for n in shard.getnames() if n.endswith("json")]  # type: ignore[arg-type]
    assert [s["component"] for s in samples] == [NAME, NAME]
    assert samples[0]["outline"]["area"] == 0.5
    assert samples[1]["outline"] is None
    assert json.loads((tmp_path / "dataset.json").read_text()) == {"info": {"a": 1}, "samples": {"train": 3, "val": 0}}
