"""Measure the flat fields of an array from a recording of a white target, and one of darkness; refuse unfit ones."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.files import Recording
from vaoi_station.photometry.darkness import Darkness, measure_darkness
from vaoi_station.photometry.flat_fields import CameraFields, FieldHead, FlatFieldDocument, FlatFields
from vaoi_station.photometry.noise import Floats32, NoiseModel, fit_line, grey_levels
from vaoi_station.photometry.radiance import is_saturated
from vaoi_station.photometry.white_target import WhiteTarget, combine

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
    """Measure one flat field per camera and light.

    Args:
        white: recording of a white target that fills all frames, at rest or moving. With `lights`, each light gets
            one field per camera.
        dark: recording of darkness, with lamps off or lenses covered. Without it the dark level is taken as zero.

    Raises:
        InputError: the recordings are not fit for it; the message names camera, light, value and limit.
    """
    head = white.head
    if dark is not None:
        _check_same_array(white, dark)
    lights = tuple(dict.fromkeys(head.light(row) for row in range(head.rows)))
    cameras: list[CameraFields] = []
    targets: dict[tuple[int, str | None], tuple[WhiteTarget, int]] = {}
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
        FieldHead(camera=i, light=light, file=f"fields/c{i:02d}_l{lights.index(light):02d}.tiff", level=t.level, rows=n)
        for (i, light), (t, n) in targets.items()
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
) -> tuple[WhiteTarget, int]:
    """Measure the white target of one camera under one light; also return the number of rows that were used."""
    head = white.head
    where = f"{white.directory}: camera {camera}" + (f", light {light!r}" if light is not None else "")
    rows = [r for r in range(head.rows) if head.light(r) == light and (camera, r) not in head.missing]
    if len(rows) < LEAST_ROWS:
        raise InputError(
            f"{where}: has {len(rows)} rows, but a flat field needs at least {LEAST_ROWS} for each light.",
            action=f"Film the white target for at least {LEAST_ROWS} rows under every light.",
        )
    dark: Floats32 | float = 0.0 if darkness is None else darkness.level if darkness.map is None else darkness.map
    signals, scales, most_saturated, least = [], [], 0.0, np.inf
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
    if len(signals) < LEAST_ROWS:
        raise _unfit(where, len(signals), most_saturated, least)
    target = combine(signals, scales)
    _check(where, target)
    return target, len(signals)


def _unfit(where: str, usable: int, saturated: float, signal: float) -> InputError:
    """Describe rows that are saturated or too dark."""
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
