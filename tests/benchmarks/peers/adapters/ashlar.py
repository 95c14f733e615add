"""ASHLAR: phase correlation of overlaps, a threshold learnt from strips that cannot match, a spanning tree.

Its readers go through Bio-Formats; frames in memory need a reader of their own, which its classes foresee. One unit
of its stage is one pixel here.
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
    """Frames of one size at their nominal places; ASHLAR counts (y, x).

    Whole pixels: it cuts overlaps at whole pixels and takes the fractions it was given for granted, which costs it
    0.2 px. The prior is wrong by pixels anyway.
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
    """Nothing to convert."""
    return strip


def place(strip: Strip, **options: Any) -> Matrices:
    """Places of all frames; the thumbnail, which serves other cycles of staining, is left out."""
    aligner = reg.EdgeAligner(_Frames(strip), do_make_thumbnail=False, **options)
    aligner.run()
    return translations(aligner.positions[:, ::-1])
