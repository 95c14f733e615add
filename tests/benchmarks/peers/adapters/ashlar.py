"""ASHLAR: phase correlation of overlaps, a threshold from pairs that cannot match, a spanning tree.

Its readers use Bio-Formats; frames in memory need the two subclasses below. One unit of its stage is one pixel here.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from ashlar import reg
from numpy.typing import NDArray

from ..adapter import Setting
from ..strip import Floats, Matrices, Strip, translations

PACKAGES = ("ashlar", "numpy", "scikit-image", "scipy")
SETTINGS = {
    "max_error=inf (no permutation test)": Setting({"max_error": np.inf}),
    "filter_sigma=1, max_error=inf": Setting({"filter_sigma": 1.0, "max_error": np.inf}),
    "default": Setting(strips=("plain", "yaw")),
}


class _Stage(reg.Metadata):  # type: ignore[misc]  # it ships no types
    """Frames of one size at their nominal positions, in order (y, x).

    Positions are rounded to whole pixels: ASHLAR cuts overlaps at whole pixels and keeps the fractions of the prior,
    which costs it 0.2 px. The prior is wrong by some pixels anyway.
    """

    def __init__(self, strip: Strip) -> None:
        self.strip = strip

    @property
    def _num_images(self) -> int:
        return len(self.strip.frames)

    @property
    def num_channels(self) -> int:
        return 1

    @property
    def pixel_size(self) -> float:
        return 1.0

    @property
    def pixel_dtype(self) -> np.dtype[Any]:
        return self.strip.frames.dtype

    def tile_position(self, i: int) -> Floats:
        return np.rint(self.strip.nominal_px[i, ::-1])

    def tile_size(self, i: int) -> NDArray[np.int64]:
        return np.array(self.strip.frames[i].shape)


class _Frames(reg.Reader):  # type: ignore[misc]  # it ships no types
    def __init__(self, strip: Strip) -> None:
        self.metadata, self._strip = _Stage(strip), strip

    def read(self, series: int, c: int) -> NDArray[np.uint8]:
        return np.asarray(self._strip.frames[series])


def prepare(strip: Strip, directory: Path) -> Strip:
    """Return the strip: there is nothing to convert."""
    return strip


def place(strip: Strip, **options: Any) -> Matrices:
    """Return positions of all frames, without the thumbnail that ASHLAR needs only for further staining cycles."""
    aligner = reg.EdgeAligner(_Frames(strip), do_make_thumbnail=False, **options)
    aligner.run()
    return translations(aligner.positions[:, ::-1])
