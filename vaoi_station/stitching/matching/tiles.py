"""Cut tiles out of an image: blurred squares, from which `refinement` takes patches and windows.

A tile is a flat array whose lines lie `PITCH_PX` apart, so that one loop runs over all lines (see `refinement`). It is
computed from a square of raw pixels, which is larger by `BLUR_REACH` on every side and may have a larger pitch.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import inlined
from vaoi_station.stitching.matching.patch_tables import BINOMIAL, BLUR_REACH, PITCH_PX, WINDOW_PX

Pixels = NDArray[np.uint8]
Plane = NDArray[np.float32]

_SATURATED = 254
"""Grey level from which a pixel counts as saturated."""
_Float = np.float32


@inlined
def cut(image: Pixels, x0: int, y0: int, raw: Pixels, size: int, pitch: int, wide: int) -> None:
    """Copy the raw pixels for a tile of side `size` from an image to `raw`, a flat array with lines `pitch` apart.

    The square of raw pixels begins at (x0, y0) of the image and is larger than the tile by `BLUR_REACH` on every side.
    Outside the image, border pixels are repeated. `wide` equals `pitch`, but is not a constant for the compiler, which
    would unroll a copy of constant length byte by byte.
    """
    h, w = image.shape
    side = size + 2 * BLUR_REACH
    if 0 <= x0 <= w - pitch and 0 <= y0 <= h - side:
        for y in range(side):
            line, to = image[y0 + y, x0 : x0 + wide], raw[y * pitch : y * pitch + wide]
            for x in range(wide):
                to[x] = line[x]
    else:
        for y in range(side):
            line = image[min(max(y0 + y, 0), h - 1)]
            for x in range(side):
                raw[y * pitch + x] = line[min(max(x0 + x, 0), w - 1)]


@inlined
def blur(raw: Pixels, half_way: Plane, out: Plane, size: int, pitch: int, less: float) -> None:
    """Blur raw pixels to a tile `out` of side `size`, and subtract the constant `less`.

    The blur first runs down the columns, in exact whole numbers, and then along the lines. `half_way` is a buffer for
    the values in between. Lines of `raw` lie `pitch` apart.
    """
    w0, w1, w2, w3 = BINOMIAL
    p = pitch
    for n in range(size * p):
        near = w1 * (raw[n + 2 * p] + raw[n + 4 * p]) + w2 * (raw[n + p] + raw[n + 5 * p])
        half_way[n] = np.uint16(w0 * raw[n + 3 * p] + near + w3 * (raw[n] + raw[n + 6 * p]))
    # 4096 = 64²: the weights of both directions are in 64ths. The sum down the columns was exact; only these products
    # round.
    v0, v1, v2, v3 = _Float(w0 / 4096), _Float(w1 / 4096), _Float(w2 / 4096), _Float(w3 / 4096)
    constant = _Float(less)
    for y in range(size):
        v, to = half_way[y * p : y * p + PITCH_PX + 2 * BLUR_REACH], out[y * PITCH_PX : (y + 1) * PITCH_PX]
        for x in range(PITCH_PX):
            near = v1 * (v[x + 2] + v[x + 4]) + v2 * (v[x + 1] + v[x + 5])
            to[x] = v0 * v[x + 3] + near + v3 * (v[x] + v[x + 6]) - constant


@inlined
def saturated_share(raw: Pixels, size: int, pitch: int, x0: int, y0: int) -> float:
    """Return the share of saturated pixels in the window whose first pixel is (x0, y0) of the raw pixels of a tile."""
    # Most tiles have no saturated pixel. Their maximum, a vectorised loop, shows this without counting.
    brightest = np.uint8(0)
    for n in range((size + 2 * BLUR_REACH) * pitch):
        brightest = max(brightest, raw[n])
    if brightest < _SATURATED:
        return 0.0
    count = 0
    for y in range(y0, y0 + WINDOW_PX):
        for x in range(x0, x0 + WINDOW_PX):
            count += raw[y * pitch + x] >= _SATURATED
    return count / (WINDOW_PX * WINDOW_PX)
