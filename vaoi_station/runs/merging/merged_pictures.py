"""Merged pictures of a component or region of a run: which there are, how bright its rows are, and their jobs.

They are chosen in the caller's thread, without pixels; a worker merges them, as it renders temporary images.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vaoi_station.errors import GoneError, InputError, InternalError, NotFoundError
from vaoi_station.geometry.transforms import Floats
from vaoi_station.hdr import Exposed
from vaoi_station.hdr.encoding import LINEAR, MergedFormat
from vaoi_station.hdr.merging import (
    bodies_in,
    distinct_exposures,
    exposure_groups,
    region_component,
    views_of_bodies,
    views_on_top,
)
from vaoi_station.hdr.row_levels import at_level
from vaoi_station.model import FrameRecord
from vaoi_station.model.recording import usual_light
from vaoi_station.model.stitch_result import Heights, known_height_mm, with_heights
from vaoi_station.photometry import FieldMaps, FlatFields, NoiseModel, Taken
from vaoi_station.photometry.flat_fields import changed_ns
from vaoi_station.rendering import View
from vaoi_station.runs.archive.component_views import component_of
from vaoi_station.runs.archive.finished_runs import FinishedRun
from vaoi_station.runs.run.memory import Bay
from vaoi_station.runs.workers.jobs import PictureJob
from vaoi_station.runs.workers.picture_jobs import LevelFrame, MergedBody, MergedFrame, MergeJob, RowLevelsJob

_log = logging.getLogger(__name__)
Lease = Callable[[str, str], AbstractContextManager[Bay]]
"""Keeps the frames of a run in memory in a `with` block; arguments are the run and the purpose."""
Render = Callable[[PictureJob, str], Any]
"""Has a worker perform a job with this name in messages, and returns the reply's value."""
MOST_WORK = 400_000_000
"""Largest number of pixels times frames of one merged picture; it takes a worker about 16 seconds."""
MOST_KEPT = 16
"""Number of runs whose levels are kept; they are one number per row."""
_UNKNOWN = FieldMaps(None, 0.0, NoiseModel())


class MergeRequest(NamedTuple):
    """What is merged: a component, or a region of the board in CAD coordinates, and how it is framed."""

    component: str | None = None
    region: tuple[float, float, float, float] | None = None
    light: str | None = None
    """Only frames under this light; None: under the light of most frames of the run."""
    px_per_mm: float | None = None
    min_coverage: float | None = None


@dataclass(frozen=True)
class MergedChoice:
    """One merged picture: its frames, best first."""

    frames: tuple[MergedFrame, ...]
    exposures: int
    """Number of different exposures among them."""
    plane_height_mm: float
    """Height of the plane above the board in which the frames are merged."""

    @property
    def view(self) -> View:
        """The best view; its size and its matrices from and to CAD are those of the picture."""
        return self.frames[0].view


def merged_pictures(
    finished: FinishedRun, wanted: MergeRequest, heights_mm: Heights | None = None
) -> tuple[MergedChoice, ...]:
    """Return the merged pictures of a request: the m_v pictures by their rows, and last that of all frames.

    `heights_mm` are heights of components that replace those of the result, which follow from few links.

    Raises:
        InputError: not exactly one of component and region is given, or the region is off the board or too large.
        NotFoundError: the component is unknown, or no usable frame shows it.
        StateError: the run has no CAD mapping.
    """
    if (wanted.component is None) == (wanted.region is None):
        raise InputError(
            "merged pictures: give exactly one of component and region.", action="Name a component, or a region."
        )
    board_type, calculator = finished.board_type, finished.view_calculator
    height = 0.0
    if wanted.component is not None:
        part = component_of(board_type, wanted.component)
        height = known_height_mm(part, board_type, with_heights(finished.result, heights_mm or {}))
    else:
        assert wanted.region is not None, "checked above"
        resolution = wanted.px_per_mm or float(np.mean([c.px_per_mm for c in finished.cameras]))
        part = region_component(wanted.region, board_type, resolution, "merged pictures: region")
    views = views_on_top(calculator, part, height, px_per_mm=wanted.px_per_mm, min_coverage=wanted.min_coverage)
    usable = [f for f in finished.detail.frames if f.usable]
    # Metal looks another way under every light: radiance under several of them has no meaning.
    light = usual_light(f.light for f in usable) if wanted.light is None else wanted.light
    records = {(f.camera, f.row): f for f in usable if f.light == light}
    sizes = [(c.width_px, c.height_px) for c in finished.cameras]
    exposed = [
        Exposed(view, taken_with(record), _UNKNOWN, sizes[view.camera], _no_pixels)
        for view in views
        if (record := records.get((view.camera, view.row))) is not None
    ]
    if not exposed:
        under = f" under the light {light!r}" if light else ""
        raise NotFoundError(
            f"No usable frame of run {finished.detail.id}{under} shows {wanted.component or 'the region'}.",
            action="Ask for another place or light, or lower min_coverage.",
            code="no-such-image",
        )
    work = sum(e.view.width * e.view.height for e in exposed)
    if work > MOST_WORK:
        first = exposed[0].view
        raise InputError(
            f"merged pictures: {first.width}×{first.height} px of {len(exposed)} frames are {work / 1e6:.0f} million "
            f"pixels, but the limit is {MOST_WORK / 1e6:.0f} million.",
            action="Ask for a smaller region, or for fewer px_per_mm.",
        )
    return tuple(
        MergedChoice(
            tuple(MergedFrame(e.view, e.taken, e.frame_size, finished.slots[e.key]) for e in group),
            len(distinct_exposures(group)),
            height,
        )
        for group in (*exposure_groups(exposed), exposed)
    )


def taken_with(record: FrameRecord) -> Taken:
    """Return what a frame was taken with. Raise InputError if its exposure is unknown."""
    if record.exposure_us is None:
        raise InputError(
            f"the exposure of camera {record.camera}, row {record.row} is unknown, so its radiance is unknown.",
            action="Configure exposure_us of the camera, or the on-time of the light.",
        )
    return Taken(record.exposure_us, record.gain or 1.0, record.light or None)


def _no_pixels() -> np.ndarray:
    raise AssertionError("frames are chosen without their pixels")


@dataclass(frozen=True)
class MergedAccess:
    """Has merged pictures made by workers. Methods may be called from any thread."""

    get: Callable[[str], FinishedRun]
    """Function that returns a finished run."""
    explained: Callable[[str], FinishedRun]
    """Function that returns a finished run with its complete result, and waits for that if need be."""
    lease: Lease
    recorded: Callable[[str, int, int], Path | None]
    """Function that returns the file of a frame in the run's recording; None if no recording is kept."""
    render: Render
    flat_fields: Path | None
    """Directory of the station's flat fields."""
    heights: Callable[[str], Heights | None] = lambda _run: None
    """Function that returns the measured heights of a run; None while there are none."""

    def pictures(self, run: str, wanted: MergeRequest) -> tuple[MergedChoice, ...]:
        """Return the merged pictures of a request; see `merged_pictures`."""
        # Those of a component lie on its top, whose height follows the verdict; those of a region on the board.
        get = self.get if wanted.component is None else self.explained
        return merged_pictures(get(run), wanted, self.heights(run))

    def image(
        self, run: str, wanted: MergeRequest, k: int | None, format: MergedFormat, *, sigma: bool = False
    ) -> bytes:
        """Return merged picture k of a request, encoded; None is the last, which is merged of all frames of the light.

        Raises:
            GoneError: the frames are no longer in memory, and no recording of the run is kept.
            InputError: the standard deviation is asked for in 8 bit, or the flat fields do not fit the run.
            NotFoundError: there is no picture k.
        """
        if sigma and format not in LINEAR:
            raise InputError.field("merged pictures", "format", format, f"{' or '.join(LINEAR)} for a sigma")
        choices = self.pictures(run, wanted)
        if k is not None and k >= len(choices):
            raise NotFoundError(
                f"{wanted.component or 'The region'} of run {run} has {len(choices)} merged pictures, numbered from 0; "
                f"there is no {k}.",
                action="See the list of merged pictures.",
                code="no-such-image",
            )
        finished, choice = self.get(run), choices[-1 if k is None else k]
        frames = choice.frames
        if self.flat_fields is not None:
            if finished.head is not None:
                # Flat fields of another array, resolution or light are refused before a worker is asked.
                lights = [f.taken.light for f in frames if f.taken.light is not None]
                FlatFields.peek(self.flat_fields).check(finished.head.cameras, lights or None)
            # As if all rows were equally bright; without flat fields that is not known.
            levels = self._brightness.levels(finished)
            frames = tuple(f._replace(taken=at_level(f.taken, levels[f.view.row])) for f in frames)
        name, first = f"{wanted.component or 'region'}/merged", frames[0]
        job = MergeJob(
            run, 0, 0, first.slot, first.view, format, frames=frames,
            bodies=self._bodies(finished, wanted, frames), flat_fields=self.flat_fields, sigma=sigma,
        )  # fmt: skip
        content: bytes
        try:
            with self.lease(run, f"image {name}") as bay:
                content = self.render(replace(job, bay=bay.number, generation=bay.generation), name)
                return content
        except GoneError:
            files = [self.recorded(run, f.view.camera, f.view.row) for f in frames]
            if None in files:
                raise
        frames = tuple(f._replace(file=file) for f, file in zip(frames, files, strict=True))
        bodies = self._bodies(finished, wanted, frames)
        content = self.render(replace(job, file=files[0], frames=frames, bodies=bodies), name)
        return content

    def _bodies(
        self, finished: FinishedRun, wanted: MergeRequest, frames: Sequence[MergedFrame]
    ) -> tuple[MergedBody, ...]:
        """Return the bodies in the picture of a region, each with those of the picture's frames that show it."""
        if wanted.region is None:
            return ()
        of, view = {(f.view.camera, f.view.row): f for f in frames}, frames[0].view
        run = finished.detail.id
        stitch = with_heights(self.explained(run).result, self.heights(run) or {})
        bodies = bodies_in(view, finished.board_type, stitch)
        return tuple(
            MergedBody(body, tuple(of[v.camera, v.row]._replace(view=v) for v in views if (v.camera, v.row) in of))
            for body, views in views_of_bodies(finished.view_calculator, bodies, view.px_per_mm)
        )

    @cached_property
    def _brightness(self) -> RowBrightness:
        assert self.flat_fields is not None, "rows are compared only with flat fields"
        return RowBrightness(self.lease, self.recorded, self.render, self.flat_fields)


class RowBrightness:
    """The levels of the rows of runs, with the flat fields of the station. Methods may be called from any thread."""

    def __init__(
        self, lease: Lease, recorded: Callable[[str, int, int], Path | None], render: Render, flat_fields: Path
    ) -> None:
        """Store the parts, as those of `MergedAccess`."""
        self._lease, self._recorded, self._render, self._flat_fields = lease, recorded, render, flat_fields
        self._kept: dict[tuple[str, int], Floats] = {}
        self._comparing = threading.Lock()
        """Held while the rows of a run are compared. Callers of a run whose levels are kept do not wait."""

    def levels(self, finished: FinishedRun) -> Floats:
        """Return the level (m,) of every row of a run; 1 for all if its rows cannot be compared."""
        key = finished.detail.id, changed_ns(self._flat_fields)
        if (known := self._kept.get(key)) is not None:
            return known
        with self._comparing:
            if (known := self._kept.get(key)) is not None:
                return known
            try:
                levels = self._compared(finished)
            except GoneError:
                # Not kept: whether the picture itself can be made is decided by its own frames.
                return _equal(finished)
            self._kept[key] = levels
            if len(self._kept) > MOST_KEPT:
                del self._kept[next(iter(self._kept))]
            return levels

    def _compared(self, finished: FinishedRun) -> Floats:
        """Return the levels of a run. Raise GoneError if none of its frames is available."""
        run, name = finished.detail.id, "brightness of the rows"
        frames = level_frames(finished.detail.frames)
        job = RowLevelsJob(
            run, 0, 0, frames, finished.board_type, finished.lean, finished.cameras, self._flat_fields, recorded=True
        )
        levels: Floats
        try:
            try:
                with self._lease(run, name) as bay:
                    own = replace(job, bay=bay.number, generation=bay.generation, recorded=False)
                    levels = self._render(own, name)
                    return levels
            except GoneError:
                kept = []
                for frame in frames:
                    with suppress(GoneError):  # The others are compared without one that was not recorded.
                        if (file := self._recorded(run, frame.camera, frame.row)) is not None:
                            kept.append(frame._replace(file=file))
                if not kept:
                    raise
                levels = self._render(replace(job, frames=tuple(kept)), name)
                return levels
        except InternalError as error:
            # Kept as well: the same comparison would end the next worker too.
            _log.warning("%s: rows count as equally bright (%s)", job, error.message)
            return _equal(finished)


def _equal(finished: FinishedRun) -> Floats:
    return np.ones(len(finished.lean.row_motion))


def level_frames(records: Iterable[FrameRecord]) -> tuple[LevelFrame, ...]:
    """Return the usable frames of which it is known what they were taken with."""
    return tuple(
        LevelFrame(f.camera, f.row, taken_with(f), f.slot)
        for f in records
        if f.usable and f.slot is not None and f.exposure_us is not None
    )
