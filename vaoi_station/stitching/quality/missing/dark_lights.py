"""Lights that stayed dark in a run: rows of a light that are black between rows that are bright.

A row is a candidate if none of its frames fits the board's motion, since a black frame has no links. It counts as dark
if all its frames are nearly without contrast, while the frames of the same cameras in the nearest sound rows before and
after it have contrast. So neither a bare belt at the ends of a run nor one covered camera looks like a dark light.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from vaoi_station.model import Reason, ReasonCode
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.stitching.matching.scene import Scene

_STEP_PX = 8
"""Distance of the pixels by which the contrast of a frame is measured."""
_NOISE_LEVELS = 8.0
"""Contrast of a frame without light, at most, in grey levels of 8 bits: noise and fixed pattern."""
_DARK_SHARE = 0.05
"""Largest contrast of a dark frame, as a share of that of the sound frames beside it: stray light."""
_SOUND_LEVELS = 40.0
"""Least contrast of a frame by which a frame beside it can be called dark, in grey levels."""
_MOST_NAMED = 12


@dataclass(frozen=True)
class RowLights:
    """The light of every row, and the outputs of the controller that light it."""

    names: tuple[str, ...] = ()
    """Name of the light of every row; empty if the lights have no names."""
    channels: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    """LED channels of every light, as far as they are known."""


@dataclass(frozen=True)
class DarkLight:
    """A light, and its rows that are black while the rows beside them are bright."""

    name: str
    rows: tuple[int, ...]
    of_rows: int
    """Number of rows of this light."""
    channels: tuple[int, ...] = ()
    """The LED channels that light it; empty if they are not known."""


def dark_lights(scene: Scene, lights: RowLights, confirmed: Collection[FrameKey]) -> tuple[DarkLight, ...]:
    """Return the lights with dark rows, in the order of their first one; empty if lights have no names.

    Args:
        scene: the good frames of the run.
        lights: the lights of the rows.
        confirmed: the frames that fit the board's motion.
    """
    sound = sorted({row for _, row in confirmed})
    if not lights.names or not sound:
        return ()
    contrasts: dict[FrameKey, float] = {}
    found: dict[str, list[int]] = {}
    # One row beyond the sound ones may still show the board. Farther away it may have left the view.
    for row in range(sound[0] - 1, min(sound[-1] + 2, len(lights.names))):
        if row >= 0 and row not in sound and _is_dark(scene, row, sound, contrasts):
            found.setdefault(lights.names[row], []).append(row)
    return tuple(
        DarkLight(name, tuple(rows), lights.names.count(name), lights.channels.get(name, ()))
        for name, rows in found.items()
        if rows[0] < sound[-1] and rows[-1] > sound[0]
    )


def dark_light_reasons(dark: Sequence[DarkLight]) -> Iterator[Reason]:
    """Yield one reason for each light with dark rows. It names the light, the rows and the LED channels."""
    for light in dark:
        named = ", ".join(map(str, light.rows[:_MOST_NAMED])) + (" …" if len(light.rows) > _MOST_NAMED else "")
        subject = f"row {named} is" if len(light.rows) == 1 else f"rows {named} are"
        s = "s" if len(light.channels) > 1 else ""
        output = f" of LED channel{s} {', '.join(map(str, light.channels))}" if light.channels else ""
        yield Reason(
            ReasonCode.LIGHT_DARK,
            f"light {light.name}: {subject} dark ({len(light.rows)} of its {light.of_rows} rows), while the rows "
            f"beside are bright: check lamp, driver and cable{output}, and film the board again",
        )


def _is_dark(scene: Scene, row: int, sound: list[int], contrasts: dict[FrameKey, float]) -> bool:
    """Return whether all frames of a row are black beside the nearest sound rows before and after it."""
    beside = (
        [near for near in sound if near < row][-1:],
        [near for near in sound if near > row][:1],
    )
    present, compared = set(scene.present), 0
    for camera in {i for i, j in present if j == row}:
        keys = [(camera, near) for rows in beside for near in rows if (camera, near) in present]
        bright = min((_contrast(scene, key, contrasts) for key in keys), default=0.0)
        if bright < _SOUND_LEVELS:
            continue
        if _contrast(scene, (camera, row), contrasts) > max(_NOISE_LEVELS, _DARK_SHARE * bright):
            return False
        compared += 1
    return compared > 0


def _contrast(scene: Scene, key: FrameKey, known: dict[FrameKey, float]) -> float:
    """Return the difference between bright and dark pixels of a frame, in grey levels."""
    if key not in known:
        low, high = np.percentile(scene.prepared(key).grey[::_STEP_PX, ::_STEP_PX], (1, 99))
        known[key] = float(high - low)
    return known[key]
