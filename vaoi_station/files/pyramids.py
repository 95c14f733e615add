"""Write pictures that are larger than memory: tiled, pyramidal (Big)TIFF, row of tiles by row of tiles.

The largest picture is the first page; its reductions by 2, 4, 8 … are in its SubIFDs, as viewers of large pictures
expect.
"""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import DeviceError, InputError
from vaoi_station.files.directories import make_directories, refuse_existing, sync_directory, sync_file

TILE_PX = 256
"""Side of a tile of the file."""
_BIG_BYTES = 2**31
"""Size from which a file is a BigTIFF: classic ones end at 4 GB, and some readers at 2 GB."""
_GDAL_NODATA = 42113
"""Tag that GIS programs read: the value of pixels without data."""


@dataclass(frozen=True)
class PyramidLayout:
    """What is written."""

    width: int
    height: int
    dtype: np.dtype[Any]
    channels: int = 1
    """1 grey, 3 colour in the order red, green, blue."""
    nodata: str = "0"
    """Value of pixels that show nothing, as text; "nan" for floats."""
    px_per_mm: float = 1.0
    description: str = ""

    @property
    def levels(self) -> int:
        """Number of pictures: until the smallest fits into one tile."""
        return 1 + max(math.ceil(math.log2(max(self.width, self.height) / TILE_PX)), 0)

    def size(self, level: int) -> tuple[int, int]:
        """Return width and height of one picture; level 0 is the largest."""
        return -(-self.width // 2**level), -(-self.height // 2**level)

    def grid(self, level: int) -> tuple[int, int]:
        """Return the numbers of tiles of one picture along x and y."""
        w, h = self.size(level)
        return -(-w // TILE_PX), -(-h // TILE_PX)

    @property
    def tile_shape(self) -> tuple[int, ...]:
        """Shape of the array of a tile."""
        return (TILE_PX, TILE_PX) if self.channels == 1 else (TILE_PX, TILE_PX, self.channels)

    @property
    def bytes(self) -> int:
        """Number of bytes of all pixels of the file."""
        tiles = sum(math.prod(self.grid(level)) for level in range(self.levels))
        return tiles * math.prod(self.tile_shape) * self.dtype.itemsize

    @property
    def bytes_needed(self) -> int:
        """Largest number of bytes on the disk while it is written: the file, and a third of it for its reductions."""
        return self.bytes * 4 // 3


MakeTile = Callable[[int, int], NDArray[Any]]
"""Returns the tile in this column and row of the largest picture, of the layout's tile shape."""


def write_pyramid(path: Path, layout: PyramidLayout, tile: MakeTile) -> None:
    """Write a pyramid; the file appears under its name when it is complete.

    Beside it lie temporary files of a third of its size while it is written; they never have names that stay.

    Raises:
        InputError: the file exists, or its directory cannot be written to.
        DeviceError: the disk is full; nothing is left on it.
    """
    import tifffile

    refuse_existing(path)
    try:
        make_directories(path.parent)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        os.close(handle)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}).", action="Choose another place.") from error
    draft = Path(name)
    try:
        with ExitStack() as stack:
            levels = _Reductions(layout, path.parent, stack)
            with tifffile.TiffWriter(draft, bigtiff=layout.bytes > _BIG_BYTES) as writer:
                for level in range(layout.levels):
                    _write_level(writer, layout, level, levels.largest(tile) if level == 0 else levels.tiles(level))
        draft.chmod(0o644)
        sync_file(draft)
        # The name is taken only if it is still free: another program may have made the file meanwhile.
        os.link(draft, path)
        sync_directory(path.parent)
    except FileExistsError as error:
        raise InputError(f"{path}: exists already.", action="Choose another path.") from error
    except OSError as error:
        raise _no_room(path, layout, f"cannot be written ({error.strerror or error})") from error
    finally:
        draft.unlink(missing_ok=True)


def refuse_without_room(path: Path, layout: PyramidLayout, left_free: int) -> None:
    """Raise DeviceError if a file would leave less than `left_free` bytes of its disk free while it is written."""
    if shutil.disk_usage(path.parent).free < layout.bytes_needed + left_free:
        raise _no_room(path, layout, f"is not written, since {left_free / 1e6:.0f} MB must stay free")


def _no_room(path: Path, layout: PyramidLayout, what: str) -> DeviceError:
    free = shutil.disk_usage(path.parent).free
    return DeviceError(
        f"{path}: {what}: the file takes {layout.bytes_needed / 1e6:.0f} MB while it is written, {free / 1e6:.0f} MB "
        "are free.",
        action="Free space, choose another disk, or give a lower resolution.",
        code="disk-full",
    )


def _write_level(writer: Any, layout: PyramidLayout, level: int, tiles: Iterator[NDArray[Any]]) -> None:
    w, h = layout.size(level)
    scale = layout.px_per_mm * 10 / 2**level
    largest = level == 0
    writer.write(
        tiles,
        shape=(h, w) if layout.channels == 1 else (h, w, layout.channels),
        dtype=layout.dtype,
        tile=(TILE_PX, TILE_PX),
        photometric="minisblack" if layout.channels == 1 else "rgb",
        subifds=layout.levels - 1 if largest else None,
        subfiletype=0 if largest else 1,
        resolution=(scale, scale),
        resolutionunit="CENTIMETER",
        description=layout.description if largest else None,
        metadata=None,
        software="vaoi_station" if largest else False,
        extratags=[(_GDAL_NODATA, 2, 0, layout.nodata, True)],
    )


class _Reductions:
    """The smaller pictures of a pyramid, in temporary files: each row of tiles is reduced as soon as it is complete."""

    def __init__(self, layout: PyramidLayout, directory: Path, stack: ExitStack) -> None:
        self._layout = layout
        self._files: list[IO[bytes]] = []
        for _ in range(layout.levels - 1):
            file = tempfile.TemporaryFile(dir=directory)  # noqa: SIM115  (the exit stack closes it)
            self._files.append(stack.enter_context(file))
        self._waiting: dict[int, NDArray[Any]] = {}
        """By level, the upper half of the row of tiles that waits for its lower half."""

    def largest(self, tile: MakeTile) -> Iterator[NDArray[Any]]:
        """Yield the tiles of the largest picture row by row, and reduce them on the way."""
        columns, rows = self._layout.grid(0)
        shape = (TILE_PX, columns * TILE_PX, *self._layout.tile_shape[2:])
        for y in range(rows):
            strip = np.empty(shape, self._layout.dtype)
            for x in range(columns):
                strip[:, x * TILE_PX : (x + 1) * TILE_PX] = tile(x, y)
            # Before the tiles are yielded: the writer does not come back after the last one.
            self._add(0, strip, y == rows - 1)
            for x in range(columns):
                yield np.ascontiguousarray(strip[:, x * TILE_PX : (x + 1) * TILE_PX])

    def tiles(self, level: int) -> Iterator[NDArray[Any]]:
        """Yield the tiles of a smaller picture, row by row."""
        file = self._files[level - 1]
        file.seek(0)
        shape, dtype = self._layout.tile_shape, self._layout.dtype
        size = math.prod(shape) * dtype.itemsize
        for _ in range(math.prod(self._layout.grid(level))):
            yield np.frombuffer(file.read(size), dtype).reshape(shape)

    def _add(self, level: int, strip: NDArray[Any], last: bool) -> None:
        """Reduce a row of tiles of one level, and write a row of tiles of the next level when it is complete."""
        if level + 1 >= self._layout.levels:
            return
        half = halved(strip)
        columns = self._layout.grid(level + 1)[0]
        upper = self._waiting.pop(level, None)
        if upper is None and not last:
            self._waiting[level] = half
            return
        row = np.zeros((TILE_PX, columns * TILE_PX, *strip.shape[2:]), strip.dtype)
        if np.issubdtype(strip.dtype, np.floating):
            row[:] = np.nan
        first = half if upper is None else upper
        row[: TILE_PX // 2, : first.shape[1]] = first
        if upper is not None:
            row[TILE_PX // 2 :, : half.shape[1]] = half
        for x in range(columns):
            self._files[level].write(np.ascontiguousarray(row[:, x * TILE_PX : (x + 1) * TILE_PX]).tobytes())
        self._add(level + 1, row, last)


def halved(picture: NDArray[Any]) -> NDArray[Any]:
    """Return a picture of even size reduced to half; a pixel without data makes the mean of the others, or none."""
    if np.issubdtype(picture.dtype, np.floating):
        seen = np.isfinite(picture)
        if seen.all():
            return _means(picture)
    else:
        seen = picture != 0
        if seen.all():
            return _means(picture)
    share = _means(seen.astype(np.float32))
    total = _means(np.where(seen, picture, 0).astype(np.float32))
    mean = total / np.maximum(share, 0.25)
    if np.issubdtype(picture.dtype, np.floating):
        return np.where(share > 0, mean, np.nan).astype(picture.dtype)
    return np.where(share > 0, np.rint(np.maximum(mean, 1)), 0).astype(picture.dtype)


def _means(picture: NDArray[Any]) -> NDArray[Any]:
    size = (picture.shape[1] // 2, picture.shape[0] // 2)
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
