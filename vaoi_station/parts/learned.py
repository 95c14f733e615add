"""What good boards of a type look like: the patches of the parts of each board that was taught, and their files.

Each board is kept by itself, so that boards can be added, removed and taken over from other stations. What is common
to them is computed when it is needed (`models`).
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.files.documents import write_bytes
from vaoi_station.model import BoardType
from vaoi_station.parts.patches import MOST_PX, Grid, RunPatches, ViewClass, kind_of

FORMAT, VERSION = "vaoi-good-board", 1
ENDING = ".parts"
"""Ending of the names of files of taught boards."""
_OWN_SHARE = 0.5
"""Least share of the parts of a taught board that a board type must have, if it is to be compared with it."""
_MOST_CLASSES, _MOST_PARTS, _MOST_MM = 16, 20_000, 1000.0
_MOST_HEAD_BYTES = 16 * 2**20
"""Limits of what a file may hold: number of view classes and of parts, heights."""


@dataclass(frozen=True, eq=False)
class TaughtBoard:
    """The patches of one good board."""

    name: str
    """The run; unique among the boards of a type."""
    board_type: str
    """Digest of the parts of the board type; see `parts_digest`."""
    calibration: str
    """Digest of the calibration."""
    classes: tuple[ViewClass, ...]
    grids: tuple[Grid, ...]
    addresses: tuple[tuple[str, ...], ...]
    """By grid: the parts that the board has there."""
    patches: tuple[NDArray[np.uint8], ...]
    """By grid: (k, classes, height, width) grey levels; a patch of zeros is not known."""
    heights_mm: tuple[NDArray[np.float32], ...]
    """By grid: (k, 3) expected height of the part above the board, 0 if unknown, and its height by parallax, alone and
    with a strip around it; NaN where it was not measured."""

    @staticmethod
    def of_run(name: str, patches: RunPatches, board_type: str, calibration: str) -> TaughtBoard:
        """Keep the patches of a run as those of a good board."""
        addresses, pictures, heights = [], [], []
        for g, grid in enumerate(patches.grids):
            mine = patches.members(g)
            addresses.append(tuple(patches.parts[k].address for k in mine))
            stack = np.zeros((len(mine), len(patches.classes), grid.height, grid.width), np.uint8)
            for c in range(len(patches.classes)):
                values = np.clip(np.rint(np.nan_to_num(patches.values[g, c])), 1, 255).astype(np.uint8)
                shown = (patches.frames[mine, c] > 0) & ~patches.dark[mine]
                stack[:, c] = np.where(shown[:, None, None], values, 0)
            pictures.append(stack)
            expected = patches.height_mm[mine]
            measured = expected + patches.above_mm[mine], expected + patches.wide_mm[mine]
            heights.append(np.column_stack([expected, *measured]).astype(np.float32))
        return TaughtBoard(
            name, board_type, calibration, patches.classes, patches.grids, tuple(addresses), tuple(pictures),
            tuple(heights),
        )  # fmt: skip

    def is_of(self, board_type: BoardType) -> bool:
        """Return whether most parts of this board are those of a board type, by address, package and size."""
        kinds = {c.address: kind_of(c, board_type) for c in board_type.components}
        same = [kinds.get(a) == grid.name for grid, some in zip(self.grids, self.addresses, strict=True) for a in some]
        return sum(same) >= _OWN_SHARE * len(same)

    def views(self, address: str) -> dict[ViewClass, NDArray[np.uint8]]:
        """Return the pictures of a part by view class; none of a part that it does not show."""
        for addresses, patches in zip(self.addresses, self.patches, strict=True):
            if address in addresses:
                mine = zip(self.classes, patches[addresses.index(address)], strict=True)
                return {view: picture for view, picture in mine if picture.any()}
        return {}

    def write(self, path: Path) -> None:
        """Write the board to a file, atomically."""
        head: dict[str, Any] = {
            "format": FORMAT, "version": VERSION, "name": self.name, "board_type": self.board_type,
            "calibration": self.calibration, "classes": self.classes,
            "grids": [{**g._asdict(), "parts": a} for g, a in zip(self.grids, self.addresses, strict=True)],
        }  # fmt: skip
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
            file.writestr("head.json", json.dumps(head, ensure_ascii=False))
            for n, (pictures, heights) in enumerate(zip(self.patches, self.heights_mm, strict=True)):
                file.writestr(f"{n}.patches", pictures.tobytes())
                file.writestr(f"{n}.heights", heights.astype("<f4").tobytes())
        write_bytes(path, out.getvalue())


def parts_digest(board_type: BoardType) -> str:
    """Return a digest of what the patches of a board type depend on: its parts, their places and sizes."""
    keys = {"ref", "panel", "center", "width", "height", "rotation", "package", "body_height"}
    text = board_type.model_dump_json(
        include={"unit": True, "y_axis": True, "side": True, "components": {"__all__": keys}}
    )
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def read_taught_board(path: Path) -> TaughtBoard:
    """Read the file of a taught board. Raise InputError if it is not one, or damaged."""
    try:
        with zipfile.ZipFile(path) as file:
            _within("the size of head.json", file.getinfo("head.json").file_size, 0, _MOST_HEAD_BYTES)
            head = json.loads(file.read("head.json"))
            if head["format"] != FORMAT or head["version"] != VERSION:
                raise InputError(
                    f"{path}: has format {head['format']!r} version {head['version']!r}, but must be {FORMAT!r} "
                    f"version {VERSION}.",
                    action="Teach the board again with this version.",
                )
            grids = tuple(_grid(g, f"grids[{n}]") for n, g in enumerate(head["grids"]))
            addresses = tuple(tuple(str(part) for part in g["parts"]) for g in head["grids"])
            every = [address for some in addresses for address in some]
            _within("the number of parts", len(every), 0, _MOST_PARTS)
            if len(set(every)) < len(every):
                raise ValueError(f"grids[].parts names {Counter(every).most_common(1)[0][0]!r} twice")
            name, board_type, calibration = (str(head[key]) for key in ("name", "board_type", "calibration"))
            classes = tuple(
                ViewClass(str(light), _within("classes[].exposure", exposure, 1e-3, 1e9))
                for light, exposure in head["classes"]
            )
            _within("the number of classes", len(classes), 0, _MOST_CLASSES)
            pictures, heights = [], []
            for n, (grid, parts) in enumerate(zip(grids, addresses, strict=True)):
                shape = (len(parts), len(classes), grid.height, grid.width)
                pictures.append(np.frombuffer(_member(file, f"{n}.patches", math.prod(shape)), np.uint8).reshape(shape))
                values = np.frombuffer(_member(file, f"{n}.heights", 12 * len(parts)), "<f4").reshape(len(parts), 3)
                if (np.isinf(values) | (np.abs(values) > _MOST_MM)).any():
                    raise ValueError(f"{n}.heights has a height beyond ±{_MOST_MM:g} mm")
                heights.append(values.astype(np.float32))
    except (
        OSError,
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        LookupError,
        ValueError,
        TypeError,
        RuntimeError,
    ) as error:
        raise InputError(
            f"{path}: is no file of a taught board, or damaged: {error}.",
            action="Remove it, and teach the board again.",
        ) from error
    return TaughtBoard(name, board_type, calibration, classes, grids, addresses, tuple(pictures), tuple(heights))


def _grid(document: Mapping[str, Any], where: str) -> Grid:
    """Return a grid of a head; raise ValueError that names key, value and limit if it is none."""
    width, height = (int(_within(f"{where}.{key}", document[key], 1, MOST_PX)) for key in ("width", "height"))
    _within(f"{where}: width · height", width * height, 1, 4 * MOST_PX)
    across, along = document["body_px"]
    body = _within(f"{where}.body_px", across, 1, width), _within(f"{where}.body_px", along, 1, height)
    return Grid(
        str(document["name"]), width, height, _within(f"{where}.px_per_mm", document["px_per_mm"], 0.1, 1e4), body
    )


def _within(name: str, value: Any, least: float, most: float) -> float:
    """Return a number; raise ValueError, with its name, if it is not between two limits."""
    if not least <= float(value) <= most:
        raise ValueError(f"{name} is {value}, must be {least:g} to {most:g}")
    return float(value)


def _member(file: zipfile.ZipFile, name: str, size: int) -> bytes:
    """Read a member of a file that must have this size: it is not unpacked if it is larger."""
    if (found := file.getinfo(name).file_size) != size:
        raise ValueError(f"{name} has {found} bytes, must have {size}")
    return file.read(name)


def joined(pieces: Sequence[TaughtBoard]) -> TaughtBoard:
    """Return one board of pieces, each with all of its parts of some kinds."""
    first = pieces[0]
    return replace(
        first,
        grids=tuple(g for piece in pieces for g in piece.grids),
        addresses=tuple(a for piece in pieces for a in piece.addresses),
        patches=tuple(p for piece in pieces for p in piece.patches),
        heights_mm=tuple(h for piece in pieces for h in piece.heights_mm),
    )


def merged(boards: Iterable[TaughtBoard]) -> tuple[TaughtBoard, ...]:
    """Return boards from several sources in the order of their names, each once."""
    by_name: dict[str, TaughtBoard] = {}
    for board in boards:
        by_name.setdefault(board.name, board)
    return tuple(by_name[name] for name in sorted(by_name))


def without(boards: Sequence[TaughtBoard], name: str) -> tuple[TaughtBoard, ...]:
    """Return the boards except one that was not good after all."""
    return tuple(board for board in boards if board.name != name)
