"""Writes crops as WebDataset: tar files of samples, each a PNG and a JSON file with the same key."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from vaoi_station.files.documents import write_json
from vaoi_station.plant.datasets.coco import outline_document
from vaoi_station.plant.datasets.crops import Crop

SAMPLES = 2000
"""Number of samples of a shard."""


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
