"""COCO: what is written is read back; boxes, areas and empty images."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.files.images import encode_png, read_image
from vaoi_station.plant.datasets import Crop
from vaoi_station.plant.datasets.coco import CocoWriter

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


def test_an_empty_split_is_an_empty_list(tmp_path: Path) -> None:
    with CocoWriter(tmp_path, ["train"], {}):
        pass
    document = json.loads((tmp_path / "annotations" / "instances_train.json").read_text())
    assert document == {"info": {}, "categories": [], "images": [], "annotations": []}


def test_an_error_leaves_no_annotations(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), CocoWriter(tmp_path, ["train"], {}) as writer:
        writer.add("other", crop(None))
    assert not list((tmp_path / "annotations").iterdir())
