"""The frames of a mosaic: what each was taken with, and which of them a mosaic uses.

One mosaic shows the board under one light. Without HDR it also has one exposure of each camera, so that noise and
saturation do not change from row to row. With HDR, frames of similar exposure make one layer each.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from vaoi_station.errors import InputError
from vaoi_station.model import RecordingHead
from vaoi_station.model.recording import usual_light

_SIMILAR = 1.5
"""Largest ratio of two sensitivities that are in one layer of an HDR mosaic."""
_SAME = 1e-5
"""Largest relative difference of two exposures that count as one: people and names give them rounded."""


class TakenFrame(NamedTuple):
    """A frame, and what it was taken with."""

    camera: int
    row: int
    exposure_us: float
    gain: float = 1.0
    light: str | None = None

    @property
    def sensitivity(self) -> float:
        """Exposure times gain, µs: grey levels are proportional to it."""
        return self.exposure_us * self.gain


@dataclass(frozen=True)
class FrameChoice:
    """The frames of a mosaic, in layers: frames of one layer were taken with one exposure per camera."""

    light: str | None
    hdr: bool
    layers: tuple[tuple[TakenFrame, ...], ...]
    """Longest exposure first. Without HDR there is one."""

    @property
    def frames(self) -> tuple[TakenFrame, ...]:
        """The frames of all layers."""
        return tuple(frame for layer in self.layers for frame in layer)


def frames_of_head(head: RecordingHead, usable: Sequence[tuple[int, int]] | None = None) -> tuple[TakenFrame, ...]:
    """Return the frames (camera, row) of a recording with what they were taken with; `usable` are those that exist."""
    lost = set(head.missing)
    every = [(i, j) for j in range(head.rows) for i in range(len(head.cameras))] if usable is None else usable
    return tuple(
        TakenFrame(i, j, head.exposure_us(i, j), head.gain(i, j), head.lights[j] if head.lights else None)
        for i, j in every
        if (i, j) not in lost
    )


def choose_frames(
    frames: Sequence[TakenFrame], *, light: str | None = None, exposure_us: float | None = None, hdr: bool = False
) -> FrameChoice:
    """Choose the frames of a mosaic.

    Args:
        frames: the usable frames of the run.
        light: take only rows of this light. By default that of most frames; of equally many, the first.
        exposure_us: take only frames of this exposure. By default, each camera's most frequent one, and of equally
            frequent ones the longest. Not with `hdr`.
        hdr: use all exposures, one layer each.

    Raises:
        InputError: no frame has this light or this exposure; the message names those there are.
    """
    if not frames:
        raise InputError("mosaic: the run has no usable frame.", action="Film the board again.")
    counts = Counter(frame.light for frame in frames)
    if light is not None and light not in counts:
        names = ", ".join(repr(name) for name in counts if name is not None) or "none that is named"
        raise InputError.field("mosaic", "light", light, f"one of the {len(counts)} lights of the run: {names}")
    chosen_light = usual_light(frame.light for frame in frames) if light is None else light
    lit = [frame for frame in frames if frame.light == chosen_light]
    if hdr:
        if exposure_us is not None:
            raise InputError(
                f"mosaic: exposure {exposure_us:g} µs and HDR exclude each other: HDR uses all exposures.",
                action="Give one of them.",
            )
        return FrameChoice(chosen_light, True, _layers(lit))
    if exposure_us is not None:
        taken = tuple(frame for frame in lit if math.isclose(frame.exposure_us, exposure_us, rel_tol=_SAME))
        if not taken:
            found = ", ".join(f"{e:g}" for e in sorted({frame.exposure_us for frame in lit}))
            raise InputError.field("mosaic", "exposure_us", exposure_us, f"one of the exposures of the run: {found} µs")
        return FrameChoice(chosen_light, False, (taken,))
    usual = {camera: _usual([f for f in lit if f.camera == camera]) for camera in {f.camera for f in lit}}
    return FrameChoice(chosen_light, False, (tuple(f for f in lit if f.sensitivity == usual[f.camera]),))


def distinct_exposures_us(frames: Iterable[TakenFrame]) -> list[float]:
    """Return the exposures that `choose_frames` distinguishes, the longest first."""
    found: list[float] = []
    for exposure_us in sorted({frame.exposure_us for frame in frames}, reverse=True):
        if not found or not math.isclose(exposure_us, found[-1], rel_tol=_SAME):
            found.append(exposure_us)
    return found


def _layers(frames: Sequence[TakenFrame]) -> tuple[tuple[TakenFrame, ...], ...]:
    """Divide frames into layers of similar sensitivity, the most sensitive first."""
    layers: list[list[TakenFrame]] = []
    for frame in sorted(frames, key=lambda f: (-f.sensitivity, f.row, f.camera)):
        if not layers or layers[-1][0].sensitivity > _SIMILAR * frame.sensitivity:
            layers.append([])
        layers[-1].append(frame)
    return tuple(map(tuple, layers))


def _usual(frames: Sequence[TakenFrame]) -> float:
    """Return the most frequent sensitivity of frames; of equally frequent ones the largest."""
    counts = Counter(frame.sensitivity for frame in frames)
    return max(counts, key=lambda s: (counts[s], s))
