"""The plan of a mosaic: for each cell of the board the frame that shows it, and for each frame its brightness.

A plan is made once for a run and a choice of frames, from a survey that reads each frame once. It is small: one number
per cell of 16 px and layer, and one coarse field per camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Stitch
from vaoi_station.model.stitch_result import known_height_mm
from vaoi_station.mosaic.cells import (
    CELL_PX,
    Sight,
    cell_shape,
    crossing_cost,
    disagreement,
    fill_rest,
    frame_cells,
    lock_bodies,
    sight_of,
)
from vaoi_station.mosaic.frames import FrameChoice, TakenFrame
from vaoi_station.mosaic.gains import Gains, estimate_gains
from vaoi_station.mosaic.grid import MosaicGrid
from vaoi_station.mosaic.projection import FrameProjector
from vaoi_station.mosaic.seams import NO_FRAME, assign_cells
from vaoi_station.mosaic.survey import Copies, FieldCache, Floats32, ReadFrame, SurveyedFrame, survey
from vaoi_station.photometry import FlatFields, NoiseModel
from vaoi_station.steps import Steps

FIELD_PX = 16
"""Side of a pixel of a camera's field, in pixels of its frames."""
_TONE_PERCENTILES = (0.5, 99.8)


class PlannedFrame(NamedTuple):
    """A frame of a plan, with the logarithm of its gain."""

    taken: TakenFrame
    log_gain: float


class RaisedBody(NamedTuple):
    """A body whose top is shown in its own plane."""

    corners: Floats
    """(4, 2) corners of its footprint where it lies, CAD coordinates of this place by C."""
    height_mm: float


class CameraPhotometry(NamedTuple):
    """What turns grey levels of one camera into those of the mosaic."""

    field: Floats32
    """(h, w) flat field times the estimated field, one value for each `FIELD_PX` px of the frame."""
    dark: float
    """Dark level, 8-bit grey levels."""
    noise: NoiseModel


@dataclass(frozen=True, eq=False)
class MosaicPlan:
    """Which frame shows each cell, and how bright each frame is."""

    base: MosaicGrid
    """The grid at the resolution of the cameras; cells are counted on it."""
    light: str | None
    hdr: bool
    reference_us: float
    """Sensitivity (exposure times gain) to which grey levels are converted without HDR."""
    frames: tuple[PlannedFrame, ...]
    layers: tuple[NDArray[np.int16], ...]
    """Of each layer the number of the frame that shows each cell (h, w); `NO_FRAME` where none does."""
    cameras: dict[int, CameraPhotometry]
    tone: tuple[float, float]
    """Radiance of the darkest and the brightest places, for display."""
    bodies: tuple[RaisedBody, ...] = ()
    """With HDR, the bodies of known height, the highest last: the layers show them from different frames."""

    @property
    def covered(self) -> float:
        """Share of the cells that some frame shows."""
        seen = np.zeros(self.layers[0].shape, bool)
        for layer in self.layers:
            seen |= layer != NO_FRAME
        return float(seen.mean())

    @property
    def dark_correction(self) -> dict[int, float]:
        """The dark level of each camera, 8-bit grey levels."""
        return {camera: photometry.dark for camera, photometry in self.cameras.items()}


def make_plan(
    choice: FrameChoice,
    read: ReadFrame,
    *,
    projector: FrameProjector,
    board_type: BoardType,
    stitch: Stitch,
    base: MosaicGrid,
    fields: FlatFields | None = None,
    copies: Copies | None = None,
) -> Steps[MosaicPlan]:
    """Survey the frames of a run and plan its mosaic, in steps of some milliseconds.

    Args:
        choice: the frames to use, in layers.
        read: returns the pixels of a frame, or None.
        projector: projects the board into the frames.
        board_type: its bodies are not cut by seams where that can be avoided.
        stitch: the run's result, for the heights of bodies.
        base: the grid of the mosaic at the resolution of the cameras.
        fields: flat fields; None without.
        copies: gets the reduced frames of the survey; None if they are not needed.
    """
    known = fields if fields is not None else FlatFields.none()
    cache = FieldCache(known)
    placed = [f for f in choice.frames if projector.places(f.camera, f.row)]
    surveyed: list[SurveyedFrame] = []
    for frame in survey(placed, read, projector, base, cache, copies):
        surveyed.append(frame)
        yield
    gains = yield from estimate_gains(surveyed, projector.cameras, calibrated=bool(known))
    index = {(s.taken.camera, s.taken.row): n for n, s in enumerate(surveyed)}
    differ = yield from disagreement(surveyed, gains, projector, cell_shape(base))
    layers = []
    for layer in choice.layers:
        numbers, sights = [index[f.camera, f.row] for f in layer if (f.camera, f.row) in index], []
        for n in numbers:
            sights.append(sight_of(surveyed[n].taken, projector, base))
            yield
        labels = yield from _labels(numbers, sights, differ.copy(), board_type, stitch, base)
        layers.append(labels)
    cameras = {
        camera: _photometry(camera, choice.light, projector, cache, known, gains)
        for camera in sorted({f.camera for f in placed})
    }
    frames = tuple(PlannedFrame(s.taken, gains.frame[s.taken.camera, s.taken.row]) for s in surveyed)
    reference = max((f.sensitivity for f in choice.frames), default=1.0)
    bodies = _raised_bodies(board_type, stitch) if choice.hdr else ()
    return MosaicPlan(
        base, choice.light, choice.hdr, reference, frames, tuple(layers), cameras, _tone(surveyed, gains.dark), bodies
    )


def _raised_bodies(board_type: BoardType, stitch: Stitch) -> tuple[RaisedBody, ...]:
    heights = ((c, known_height_mm(c, board_type, stitch)) for c in board_type.components)
    raised = [(c, height_mm) for c, height_mm in heights if height_mm]
    footprints = stitch.footprints(board_type, [c for c, _ in raised])
    found = (RaisedBody(corners, height_mm) for (_, height_mm), corners in zip(raised, footprints, strict=True))
    return tuple(sorted(found, key=lambda body: body.height_mm))


def _labels(
    numbers: Sequence[int],
    sights: Sequence[Sight],
    differ: Floats32,
    board_type: BoardType,
    stitch: Stitch,
    base: MosaicGrid,
) -> Steps[NDArray[np.int16]]:
    """Assign each cell of one layer to a frame; `numbers` are the numbers of the layer's frames in the plan."""
    if not sights:
        return np.full(differ.shape, NO_FRAME, np.int16)
    cost = crossing_cost(differ)
    locked = yield from lock_bodies(board_type, stitch, sights, base, cost)
    labels = yield from assign_cells(frame_cells(sights, CELL_PX / base.px_per_mm), cost, locked)
    yield from fill_rest(labels, sights)
    known = np.array([*numbers, NO_FRAME], np.int16)
    return known[labels]


def _photometry(
    camera: int, light: str | None, projector: FrameProjector, cache: FieldCache, known: FlatFields, gains: Gains
) -> CameraPhotometry:
    eye = projector.cameras[camera]
    w, h = (-(-n // FIELD_PX) for n in (eye.width_px, eye.height_px))
    y, x = np.mgrid[:h, :w] * float(FIELD_PX) + (FIELD_PX - 1) / 2
    field = np.exp(gains.log_field(camera, eye, np.stack([x, y], -1))).astype(np.float32)
    flat, dark = cache.reduced(camera, light, FIELD_PX)
    if not isinstance(flat, float):
        # The reduced field lacks what is left of the last block; it continues with its last value.
        fh, fw = flat.shape
        field *= np.pad(flat, ((0, h - fh), (0, w - fw)), mode="edge")
    level = float(np.mean(dark)) + gains.dark
    return CameraPhotometry(field, level, known.maps(camera, light).noise)


def _tone(surveyed: Sequence[SurveyedFrame], dark: float) -> tuple[float, float]:
    """Return a low and a high percentile of the radiance of all frames."""
    values = [(s.values[::2, ::2] - dark / s.taken.sensitivity).ravel() for s in surveyed]
    found = np.concatenate(values) if values else np.zeros(0, np.float32)
    found = found[np.isfinite(found)]
    if not len(found):
        return 1e-6, 1.0
    low, high = np.percentile(found, _TONE_PERCENTILES)
    high = max(float(high), 1e-9)
    return max(float(low), 1e-4 * high), high
