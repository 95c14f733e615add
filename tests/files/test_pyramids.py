"""Pyramidal TIFF files: levels, values without data, and nothing left behind by a failure."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from vaoi_station.errors import DeviceError, InputError
from vaoi_station.files.pyramids import TILE_PX, PyramidLayout, write_pyramid


def tiles_of(picture: np.ndarray, fill: float = 0) -> Any:
    """A function that cuts tiles out of a picture."""

    def tile(x: int, y: int) -> np.ndarray:
        part = picture[y * TILE_PX : (y + 1) * TILE_PX, x * TILE_PX : (x + 1) * TILE_PX]
        whole = np.full((TILE_PX, TILE_PX, *picture.shape[2:]), fill, picture.dtype)
        whole[: part.shape[0], : part.shape[1]] = part
        return whole

    return tile


@pytest.mark.parametrize("channels", [1, 3])
def test_levels_are_reductions_of_the_largest(tmp_path: Path, channels: int) -> None:
    g = np.random.default_rng(0)
    shape = (700, 1100) if channels == 1 else (700, 1100, 3)
    picture = g.integers(1, 255, shape).astype(np.uint8)
    layout = PyramidLayout(1100, 700, np.dtype(np.uint8), channels, px_per_mm=40.0)
    write_pyramid(tmp_path / "p.tif", layout, tiles_of(picture))
    with tifffile.TiffFile(tmp_path / "p.tif") as file:
        levels = file.series[0].levels
        assert [level.shape[:2] for level in levels] == [(700, 1100), (350, 550), (175, 275), (88, 138)]
        np.testing.assert_array_equal(levels[0].asarray(), picture)
        blocks = picture.reshape(350, 2, 550, 2, -1).mean((1, 3)).reshape(levels[1].shape)
        assert np.abs(levels[1].asarray() - blocks).max() <= 1
        assert file.pages.first.tags["GDAL_NODATA"].value == "0"
        assert file.pages.first.tags["XResolution"].value == (400, 1)
    assert [p.name for p in tmp_path.iterdir()] == ["p.tif"]


def test_existing_file_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "p.tif"
    path.write_text("mine")
    with pytest.raises(InputError, match=r"p\.tif: exists already"):
        write_pyramid(path, PyramidLayout(10, 10, np.dtype(np.uint8)), tiles_of(np.ones((10, 10), np.uint8)))
    assert path.read_text() == "mine"


def test_file_that_appears_meanwhile_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "p.tif"

    def tile(x: int, y: int) -> np.ndarray:
        path.write_text("of another")
        return np.ones((TILE_PX, TILE_PX), np.uint8)

    with pytest.raises(InputError, match="exists"):
        write_pyramid(path, PyramidLayout(10, 10, np.dtype(np.uint8)), tile)
    assert [p.name for p in tmp_path.iterdir()] == ["p.tif"]
    assert path.read_text() == "of another"


def test_full_disk_is_reported_with_numbers_and_leaves_nothing(tmp_path: Path) -> None:
    def tile(x: int, y: int) -> np.ndarray:
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(
        DeviceError, match=r"No space left on device\): the file takes \d+ MB .* MB are free"
    ) as refused:
        write_pyramid(tmp_path / "p.tif", PyramidLayout(3000, 3000, np.dtype(np.uint8)), tile)
    assert refused.value.code == "disk-full"
    assert list(tmp_path.iterdir()) == []
