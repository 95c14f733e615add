"""Writes crops as COCO: a directory of PNG files and one JSON file for each split.

The lists of a JSON file are collected on the disk: a plant's data set has more entries than fit into memory.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np

from vaoi_station.plant.datasets.crops import Crop

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
