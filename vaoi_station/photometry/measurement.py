"""Measure the flat fields of an array from a recording of a white target, and one of darkness; refuse unfit ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from statistics import NormalDist
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.files import Recording
from vaoi_station.photometry.flat_fields import CameraFields, FieldHead, FlatFieldDocument, FlatFields
from vaoi_station.photometry.noise import FULL_SCALE, Floats32, NoiseModel, fit_line, grey_levels, is_saturated

Floats64 = NDArray[np.float64]

_INNER = (0.03, 0.97)
"""Shares of the distribution between which it is fitted: hot pixels are in its upper end."""
_LEAST_SIGMA = 0.3
"""Least read noise in grey levels; quantisation alone is 0.29."""
SMOOTHING_PX = 10.0
"""σ of the smoothing of maps. It removes noise, and keeps what lenses, lamps and sensors do on larger scales."""
_WINDOW_PX = 15
"""Side of the window in which the variance of single pixels is compared with that of noise."""
_LEAST_STRUCTURE = 0.1
"""Standard deviation, grey levels, of the dark level over the frame, below which one number is used for all pixels."""
_NOISE_MARGIN = 1.15
"""Factor on the variance of noise, below which scatter from pixel to pixel counts as noise."""


@dataclass(frozen=True, eq=False)
class Darkness:
    """The dark level of one camera and its read noise, in grey levels."""

    level: float
    read: float
    map: Floats32 | None
    """(h, w) dark level pixel by pixel, where it differs; otherwise None."""


def measure_darkness(frames: Sequence[Floats32]) -> Darkness:
    """Measure the darkness of one camera from grey levels (h, w) of n frames of darkness."""
    level, read = uncut_normal(np.concatenate([frame.ravel()[::7] for frame in frames]))
    mean = np.mean(np.stack(frames), axis=0, dtype=np.float32)
    # Hot pixels and columns stay in the map; its mean is shifted by what is cut off at zero.
    shifted = np.asarray(mean - np.float32(mean.mean() - level), dtype=np.float32)
    smooth = cv2.GaussianBlur(shifted, (0, 0), SMOOTHING_PX, borderType=cv2.BORDER_REFLECT)
    found = smooth + without_noise(shifted - smooth, np.float32(read**2 / len(frames)))
    varies = float(found.std()) > _LEAST_STRUCTURE
    return Darkness(max(level, 0.0), read, np.asarray(found, dtype=np.float32) if varies else None)


def uncut_normal(values: NDArray[np.float32]) -> tuple[float, float]:
    """Estimate mean and standard deviation of normal values that were rounded, and cut off at zero.

    A line is fitted to the quantiles of the distribution, at the limits between neighbouring grey levels.
    """
    levels, counts = np.unique(values, return_counts=True)
    share = np.cumsum(counts)[:-1] / counts.sum()
    limits = (levels[:-1] + levels[1:]) / 2
    inner = (share > _INNER[0]) & (share < _INNER[1])
    if inner.sum() < 2:
        return float(values.mean()), max(float(values.std()), _LEAST_SIGMA)
    share, limits = share[inner], limits[inner]
    normal = NormalDist()
    quantile = np.array([normal.inv_cdf(p) for p in share])
    density = np.exp(-(quantile**2) / 2)
    slope, offset = np.polyfit(limits, quantile, 1, w=density / np.sqrt(share * (1 - share)))
    return float(-offset / slope), max(float(1 / slope), _LEAST_SIGMA)


def without_noise(residual: NDArray[np.float32], variance: NDArray[np.float32] | np.float32) -> NDArray[np.float32]:
    """Reduce residuals (h, w) of single pixels to the share that is more than noise of a known variance.

    Where residuals scatter as noise does, nothing is left; where they scatter more, as at dust, they are kept.
    """
    local = cv2.blur(np.square(residual), (_WINDOW_PX, _WINDOW_PX), borderType=cv2.BORDER_REFLECT)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.clip(1 - _NOISE_MARGIN * variance / local, 0, 1)
    return np.asarray(np.nan_to_num(share) * residual, dtype=np.float32)


_SURFACE_BLOCK_PX = 16
"""Side of the blocks to which the polynomial over the frame is fitted."""
_DEGREE = 4
_OUTLIER = 4.0
"""Deviations from the median of the rows, in standard deviations, that are left out of the mean."""
_WIDE_PX = 31
"""Side of the window over which the noise of single pixels is averaged."""
_TRIM = 5.0
"""Variances above this multiple of their median belong to dust or to motion, not to noise."""
_STRUCTURE_PX = 20.0
"""σ of the smoothing that separates structure of a target from the shading of lens and lamp."""
_LEAST = 1e-3
"""Least relative brightness that is divided by."""
_SUBSAMPLE = 4
_BINS = 16


@dataclass(frozen=True, eq=False)
class WhiteTarget:
    """A white target as one camera sees it under one light."""

    surface: Floats32
    """(h, w) grey levels per unit of exposure · gain."""
    flicker: float
    """Largest deviation of the brightness of a row from the median of the rows, as a share."""
    structure: float
    """Rms deviation from a smooth surface, without noise, as a share of the brightness."""
    motion: float
    """Rms change from row to row, without noise, as a share of the brightness."""
    darkest: float
    """Brightness of the darkest place of the frame as a share of the mean."""
    signals: NDArray[np.float64]
    """(k,) signals in grey levels at which the noise was measured."""
    variances: NDArray[np.float64]
    """(k,) variances there, in squared grey levels."""

    @property
    def level(self) -> float:
        """Mean of the surface."""
        return float(self.surface.mean(dtype=np.float64))


def combine(signals: Sequence[Floats32], scales: Sequence[float]) -> WhiteTarget:
    """Combine n ≥ 2 rows (h, w) of grey levels whose dark level is subtracted."""
    centres = np.array([float(np.median(s[::_SUBSAMPLE, ::_SUBSAMPLE])) for s in signals])
    rates = centres / np.asarray(scales)
    rate, centre = float(np.median(rates)), float(centres.mean())
    stack = np.stack([s / np.float32(c) for s, c in zip(signals, centres, strict=True)])
    middle = np.asarray(np.median(stack, axis=0), dtype=np.float32)
    variance = np.asarray(np.var(stack, axis=0, ddof=1), dtype=np.float32)
    limit = np.float32(_TRIM * float(np.median(variance[::_SUBSAMPLE, ::_SUBSAMPLE])))
    local = _mean_where(variance, variance <= limit, _WIDE_PX)
    kept = np.abs(stack - middle) <= _OUTLIER * np.sqrt(local)
    mean = np.asarray((stack * kept).sum(0) / np.maximum(kept.sum(0), 1), dtype=np.float32)
    shape = _polynomial(mean)
    smooth = _smooth(mean, shape, SMOOTHING_PX)
    residual = mean / smooth - 1
    noise = np.asarray(local / (np.square(smooth) * len(signals)), dtype=np.float32)
    fine = without_noise(residual, noise)
    moving = [cv2.blur(row - middle, (7, 7), borderType=cv2.BORDER_REFLECT) for row in stack]
    # Noise is averaged away over 7×7 pixels; what remains moves, or is structure.
    still = cv2.blur(mean / _smooth(mean, shape, _STRUCTURE_PX), (5, 5), borderType=cv2.BORDER_REFLECT) - 1
    return WhiteTarget(
        np.asarray(smooth * (1 + fine) * np.float32(rate), dtype=np.float32),
        float(np.abs(rates / rate - 1).max()),
        float(np.sqrt(np.mean(np.square(still), dtype=np.float64))),
        float(np.sqrt(np.mean(np.square(moving), dtype=np.float64) * len(signals) / (len(signals) - 1))),
        float(smooth.min() / smooth.mean()),
        *_binned(smooth * np.float32(centre), variance * np.float32(centre) ** 2, variance <= limit),
    )


def _smooth(mean: Floats32, shape: Floats32, sigma_px: float) -> Floats32:
    """Smooth the ratio of a picture (h, w) to a surface near it, which avoids a shift at the borders."""
    ratio = cv2.GaussianBlur(mean / shape, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT)
    return np.maximum(np.asarray(shape * ratio, dtype=np.float32), np.float32(_LEAST))


def _polynomial(mean: Floats32) -> Floats32:
    """Fit a polynomial of degree 4 to a picture (h, w), and return its values."""
    h, w = mean.shape
    blocks = cv2.resize(
        mean, (max(w // _SURFACE_BLOCK_PX, 2), max(h // _SURFACE_BLOCK_PX, 2)), interpolation=cv2.INTER_AREA
    )
    by, bx = (np.polynomial.legendre.legvander(_centres(n), _DEGREE) for n in blocks.shape)
    powers = [(a, b) for a in range(_DEGREE + 1) for b in range(_DEGREE + 1 - a)]
    columns = np.stack([np.outer(by[:, a], bx[:, b]).ravel() for a, b in powers], -1)
    values = np.linalg.lstsq(columns, blocks.ravel().astype(np.float64), rcond=None)[0]
    coefficients = np.zeros((_DEGREE + 1, _DEGREE + 1))
    for (a, b), value in zip(powers, values, strict=True):
        coefficients[a, b] = value
    y, x = (np.polynomial.legendre.legvander(_centres(n), _DEGREE) for n in (h, w))
    return np.maximum((y @ coefficients @ x.T).astype(np.float32), np.float32(_LEAST))


def _centres(n: int) -> NDArray[np.float64]:
    """Return the centres of n equal parts of −1 … 1."""
    return np.asarray((np.arange(n) + 0.5) * 2 / n - 1)


def _mean_where(values: Floats32, chosen: NDArray[np.bool_], side_px: int) -> Floats32:
    """Return the mean of the chosen values (h, w) in a window around each pixel; the mean of all where none is."""
    weight = chosen.astype(np.float32)
    window = (side_px, side_px)
    total = cv2.blur(values * weight, window, borderType=cv2.BORDER_REFLECT)
    share = cv2.blur(weight, window, borderType=cv2.BORDER_REFLECT)
    overall = np.float32(values[chosen].mean()) if chosen.any() else np.float32(values.mean())
    return np.asarray(np.where(share > _LEAST, total / np.maximum(share, _LEAST), overall), dtype=np.float32)


def _binned(
    signal: Floats32, variance: Floats32, chosen: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Average variances over bins of equal numbers of pixels of similar signal: signals (k,) and variances (k,)."""
    s, v = (a[chosen].astype(np.float64) for a in (signal, variance))
    order = np.array_split(np.argsort(s), _BINS)
    means = [(s[part].mean(), v[part].mean()) for part in order if len(part)]
    return np.array([m[0] for m in means]), np.array([m[1] for m in means])


LEAST_ROWS = 4
"""Least number of usable rows per camera and light."""
_MOST_ROWS = 12
"""Largest number of rows of one light that are used; more would only need memory."""
LEAST_SIGNAL = 20.0
"""Least mean signal of a white target, grey levels. Below it, read noise and dark level have too much effect."""
_MOST_SATURATED = 1e-3
"""Largest share of saturated pixels in a usable row."""
_MOST_DARK = 64.0
"""Largest dark level in grey levels."""
MOST_STRUCTURE = 0.04
"""Largest rms deviation of a white target from a smooth surface, and from row to row; targets with dust have 0.01."""
_MOST_FLICKER = 0.25
"""Largest deviation of the brightness of a row from that of the other rows of its light."""
_LEAST_CORNER = 0.05
"""Least brightness of the darkest part of the frame, as a share of the mean."""
_LEAST_SHOT = 1e-4


def measure_flat_fields(white: Recording, dark: Recording | None = None) -> FlatFields:
    """Measure one flat field per camera and light from a white target that fills all frames.

    Without a recording of darkness, with lamps off or lenses covered, the dark level is taken as zero. Raises
    `InputError` with camera, light, value and limit if the recordings are not fit for it.
    """
    head = white.head
    if dark is not None:
        _check_same_array(white, dark)
    lights = tuple(dict.fromkeys(head.light(row) for row in range(head.rows)))
    cameras: list[CameraFields] = []
    targets: dict[tuple[int, str | None], tuple[WhiteTarget, list[Floats64]]] = {}
    darks: dict[int, Floats32] = {}
    for i, shape in enumerate(head.cameras):
        darkness = _measure_dark(dark, i) if dark else None
        found = [_measure_white(white, i, light, darkness) for light in lights]
        targets |= {(i, light): target for light, target in zip(lights, found, strict=True)}
        name = None
        if darkness is not None and darkness.map is not None:
            name, darks[i] = f"fields/c{i:02d}_dark.tiff", darkness.map
        noise = _noise([target for target, _ in found], darkness)
        size: dict[str, Any] = {"width": shape.width, "height": shape.height, "dark_file": name}
        level = darkness.level if darkness else 0.0
        cameras.append(CameraFields(**size, dark=level, read=noise.read, shot=noise.shot, serial=shape.serial))
    # One common factor keeps the ratios of cameras and lights: a white target has one radiance for all of them.
    common = float(np.mean([target.level for target, _ in targets.values()]))
    fields = [
        FieldHead(
            camera=i,
            light=light,
            file=f"fields/c{i:02d}_l{lights.index(light):02d}.tiff",
            level=t.level,
            rows=len(used),
            white=_white(used),
        )
        for (i, light), (t, used) in targets.items()
    ]
    created = datetime.now(UTC).isoformat(timespec="seconds")
    document = FlatFieldDocument(
        format="vaoi-flatfield", version=1, created=created, cameras=tuple(cameras), fields=tuple(fields)
    )
    flats = {key: np.asarray(t.surface / np.float32(common), dtype=np.float32) for key, (t, _) in targets.items()}
    return FlatFields(document, flats, darks, str(white.directory))


def _check_same_array(white: Recording, dark: Recording) -> None:
    sizes = [[(c.width, c.height) for c in recording.head.cameras] for recording in (white, dark)]
    if sizes[0] != sizes[1]:
        shown = [", ".join(f"{w}×{h}" for w, h in size) for size in sizes]
        raise InputError(
            f"{dark.directory}: has {len(sizes[1])} cameras of {shown[1]} px, but {white.directory} has "
            f"{len(sizes[0])} of {shown[0]} px.",
            action="Film both with the same array at the same resolution.",
        )


def _measure_dark(dark: Recording, camera: int) -> Darkness:
    rows = [row for row in range(dark.head.rows) if (camera, row) not in dark.head.missing]
    if len(rows) < LEAST_ROWS:
        raise InputError(
            f"{dark.directory}: has {len(rows)} rows of camera {camera}, but darkness needs at least {LEAST_ROWS}.",
            action="Film more rows with the lamps off.",
        )
    frames = [grey_levels(_frame(dark, camera, row)) for row in _spread(rows)]
    level = max(float(frame.mean()) for frame in frames)
    if level > _MOST_DARK:
        raise InputError(
            f"{dark.directory}: camera {camera} has a dark level of {level:.0f} grey levels, but it must be at most "
            f"{_MOST_DARK:.0f} (of 255).",
            action="Switch the lamps off or cover the lenses, and keep daylight out.",
        )
    return measure_darkness(frames)


def _measure_white(
    white: Recording, camera: int, light: str | None, darkness: Darkness | None
) -> tuple[WhiteTarget, list[Floats64]]:
    """Measure the white target of one camera under one light; also return the mean signals of the rows that were used.

    Those of a row are (1,) of a grey camera, else (4,): of the grey level, red, green and blue.
    """
    head = white.head
    where = f"{white.directory}: camera {camera}" + (f", light {light!r}" if light is not None else "")
    rows = [r for r in range(head.rows) if head.light(r) == light and (camera, r) not in head.missing]
    if len(rows) < LEAST_ROWS:
        raise InputError(
            f"{where}: has {len(rows)} rows, but a flat field needs at least {LEAST_ROWS} for each light.",
            action=f"Film the white target for at least {LEAST_ROWS} rows under every light.",
        )
    dark: Floats32 | float = 0.0 if darkness is None else darkness.level if darkness.map is None else darkness.map
    signals, scales, means, most_saturated, least = [], [], [], 0.0, np.inf
    for row in _spread(rows):
        pixels = _frame(white, camera, row)
        saturated = float(is_saturated(pixels).mean())
        signal = np.asarray(grey_levels(pixels) - dark, dtype=np.float32)
        mean = float(signal.mean())
        most_saturated, least = max(most_saturated, saturated), min(least, mean)
        # Where exposures change from row to row, some rows suit and others do not.
        if saturated <= _MOST_SATURATED and mean >= LEAST_SIGNAL:
            signals.append(signal)
            scales.append(head.exposure_us(camera, row) * head.gain(camera, row))
            colours = pixels.mean((0, 1))[::-1] * FULL_SCALE / np.iinfo(pixels.dtype).max if pixels.ndim == 3 else ()
            means.append(np.array([mean, *(np.asarray(colours) - np.mean(dark))]))
    if len(signals) < LEAST_ROWS:
        raise _unfit(where, len(signals), most_saturated, least)
    target = combine(signals, scales)
    _check(where, target)
    return target, means


def _white(rows: Sequence[Floats64]) -> tuple[float, float, float] | None:
    """Return red, green and blue of a white target as shares of its grey level; None in grey."""
    grey, *colours = np.sum(rows, axis=0).tolist()
    if not colours:
        return None
    red, green, blue = (round(max(colour, 0.0) / grey, 4) for colour in colours)
    return red, green, blue


def _unfit(where: str, usable: int, saturated: float, signal: float) -> InputError:
    if saturated > _MOST_SATURATED:
        return InputError(
            f"{where}: {saturated:.1%} of the pixels are saturated, but at most {_MOST_SATURATED:.1%} may be; "
            f"{usable} of at least {LEAST_ROWS} rows are usable.",
            action="Shorten the exposure until the white target has about 180 of 255 grey levels.",
        )
    return InputError(
        f"{where}: is too dark: the white target is {signal:.1f} grey levels above the dark level, but must be at "
        f"least {LEAST_SIGNAL:.0f} (of 255); {usable} of at least {LEAST_ROWS} rows are usable.",
        action="Lengthen the exposure or the on-time of the lamp until it has about 180 grey levels.",
    )


def _check(where: str, target: WhiteTarget) -> None:
    """Refuse what is no evenly white target under a steady lamp."""
    if target.flicker > _MOST_FLICKER:
        raise InputError(
            f"{where}: the brightness of a row differs by {target.flicker:.0%} from the median of the rows, but the "
            f"limit is {_MOST_FLICKER:.0%}.",
            action="Let the white target fill all frames of all rows, and check lamp and exposures.",
        )
    if target.darkest < _LEAST_CORNER:
        raise InputError(
            f"{where}: the darkest part of the frame has {target.darkest:.1%} of the mean brightness, but must have at "
            f"least {_LEAST_CORNER:.0%}.",
            action="Let the white target fill the frame, and the lamp reach all of it.",
        )
    worst = max(target.structure, target.motion)
    if worst > MOST_STRUCTURE:
        what = "from a smooth surface" if target.structure >= target.motion else "from row to row"
        raise InputError(
            f"{where}: the picture is structured: its brightness differs by {worst:.1%} rms {what}, but the limit is "
            f"{MOST_STRUCTURE:.0%}.",
            action="Film a plain white target that fills the frames, not a board, and clean it.",
        )


def _noise(targets: Sequence[WhiteTarget], darkness: Darkness | None) -> NoiseModel:
    """Fit read and shot noise of one camera to its targets under all lights, and to its darkness if it is known."""
    signals = np.concatenate([t.signals for t in targets])
    variances = np.concatenate([t.variances for t in targets])
    if darkness is None:
        return fit_line(signals, variances, np.ones_like(signals))
    shot = float(np.mean((variances - darkness.read**2) / np.maximum(signals, 1.0)))
    return NoiseModel(darkness.read, max(shot, _LEAST_SHOT))


def _spread(rows: Sequence[int]) -> list[int]:
    """Choose at most `_MOST_ROWS` rows, evenly."""
    at = np.linspace(0, len(rows) - 1, min(len(rows), _MOST_ROWS)).round().astype(int)
    return [rows[k] for k in at]


def _frame(recording: Recording, camera: int, row: int) -> NDArray[Any]:
    pixels = recording.frame(camera, row)
    assert pixels is not None, "rows with missing frames are left out"
    return pixels
