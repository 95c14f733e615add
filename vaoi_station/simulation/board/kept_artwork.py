"""The drawings of the latest boards on disk, beside the machine code: a demo's board takes a second of CPU to draw."""

from __future__ import annotations

import hashlib
import pickle
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

import vaoi_station.geometry.transforms
from vaoi_station.compiled import cache_directory, read_kept, write_kept
from vaoi_station.simulation.board.artwork import Artwork, draw
from vaoi_station.simulation.scenario import BoardSection

_MOST_BYTES = 64 << 20
"""Largest drawing that is kept; that of the shipped demo has 30 MB."""
_KEPT = 2
_SUFFIX = ".artwork"


def kept_or_drawn(section: BoardSection, px_per_mm: float, belt_grey: float) -> Artwork:
    """Return what `draw` returns, from disk if it was drawn before by the same code; its textures are read-only."""
    directory = cache_directory()
    if directory is None or section.file is not None:  # the content of a given board type may change
        return draw(section, px_per_mm, belt_grey)
    key = repr((section.model_dump_json(), px_per_mm, belt_grey, _drawn_by()))
    file = directory / f"{hashlib.sha256(key.encode()).hexdigest()[:20]}{_SUFFIX}"
    if (content := read_kept(file)) is not None:
        artwork: Artwork = pickle.loads(content)
        return artwork
    artwork = draw(section, px_per_mm, belt_grey)
    content = pickle.dumps(artwork, pickle.HIGHEST_PROTOCOL)
    if len(content) <= _MOST_BYTES:
        write_kept(file, content)
        kept = sorted(directory.glob(f"*{_SUFFIX}"), key=_used_s, reverse=True)
        for old in kept[_KEPT:]:
            with suppress(OSError):  # It may be another user's.
                old.unlink()
    return artwork


def _used_s(file: Path) -> float:
    try:
        return file.stat().st_mtime
    except OSError:  # another process has removed it
        return 0.0


@lru_cache(maxsize=1)
def _drawn_by() -> str:
    """Return a digest of all that a drawing depends on beside its board: code of this package, and libraries."""
    files = [*sorted(Path(__file__).parents[1].rglob("*.py")), Path(vaoi_station.geometry.transforms.__file__)]
    code = b"".join(file.read_bytes() for file in files)
    return f"{hashlib.sha256(code).hexdigest()} {np.__version__} {cv2.__version__}"
