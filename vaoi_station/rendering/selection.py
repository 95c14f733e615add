"""The selection of temporary images by light, direction, exposure and quality, and their order.

*Best first* means: the largest share of the footprint (in steps of 0.001), then the smallest distance from the centre
of the frame, where the component is seen most nearly from above; equal ones by row and camera. *Sharpest first* means:
the largest share of the footprint in steps of 5 %, then the smallest share of saturated pixels in steps of 1 %, then
the greatest sharpness.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vaoi_station.errors import InputError, StateError
from vaoi_station.model import RecordingHead
from vaoi_station.rendering.measures import Measures
from vaoi_station.rendering.request import AZIMUTHS, WITHIN_DEG, Bounds, Choice, ImageRequest
from vaoi_station.rendering.view import View

Measure = Callable[[View], "Measures | None"]
"""Function that measures a view's frame; it returns None if the frame is no longer available."""


class FrameFacts(NamedTuple):
    """What is known about how a frame was taken."""

    exposure_us: float | None = None
    gain: float | None = None
    light: str | None = None
    time_s: float | None = None
    """Time of the row's pulse after that of row 0."""

    def brightness_to(self, other: FrameFacts) -> float:
        """Return how much brighter a frame is than another one of the same scene; 1 if exposures are not known."""
        if self.exposure_us is None or other.exposure_us is None:
            return 1.0
        return self.exposure_us * (self.gain or 1.0) / (other.exposure_us * (other.gain or 1.0))


def frame_facts(head: RecordingHead) -> dict[tuple[int, int], FrameFacts]:
    """Return how each frame (camera, row) of a recording was taken."""
    times_s = (head.row_times_s() - head.row_times_s()[0]).tolist()
    lights = head.lights or ("",) * head.rows
    return {
        (i, j): FrameFacts(head.exposure_us(i, j), head.gain(i, j), lights[j] or None, times_s[j])
        for i in range(len(head.cameras))
        for j in range(head.rows)
    }


@dataclass(frozen=True, eq=False)
class ChosenView:
    """One temporary image that was chosen: its view, how its frame was taken, and what was measured."""

    view: View
    facts: FrameFacts
    measures: Measures | None = None
    """None if nothing was measured."""
    minus: ChosenView | None = None
    """The image that is subtracted from this one; None for a plain image."""

    @property
    def ratio(self) -> float:
        """Factor on the grey levels of the subtracted image, that makes its exposure that of this image."""
        return 1.0 if self.minus is None else self.facts.brightness_to(self.minus.facts)


def select(
    views: Iterable[View], facts: Mapping[tuple[int, int], FrameFacts], wanted: ImageRequest, measure: Measure
) -> tuple[ChosenView, ...]:
    """Choose and order the views of one component.

    Args:
        views: views of the component in the frames that may be used, best first.
        facts: how each frame (camera, row) of the run was taken.
        wanted: the request.
        measure: function that measures a view; it is called only if the request needs it.

    Raises:
        InputError: the run has no frame under a light that the request names.
        StateError: the request names a direction, and directions are not known.
    """
    bounds, choice = wanted.bounds, wanted.choice
    for key, light in (("light", choice.light), ("minus", choice.minus)):
        _require_light(key, light, facts.values())
    every = [ChosenView(view, facts.get((view.camera, view.row), FrameFacts())) for view in views]
    found = [s for s in every if choice.light is None or s.facts.light == choice.light]
    if choice.seen_from is not None or bounds.min_angle_deg > 0 or bounds.max_angle_deg < 90:
        _require_directions(s.view for s in found)
        found = [s for s in found if _is_seen_from(s.view, bounds, choice)]
    found = [s for s in found if _is_exposed(s.facts, bounds)]
    if choice.minus is not None:
        others = [s for s in every if s.facts.light == choice.minus]
        found = [ChosenView(s.view, s.facts, minus=_nearest(s, others)) for s in found] if others else []
    if wanted.needs_pixels:
        found = _measured(found, measure)
        found = [s for s in found if _is_good(s.measures, bounds)]
    if choice.order == "sharpest":
        found.sort(key=_sharpness_rank)
    found = found[: choice.limit]
    return tuple(_measured(found, measure) if choice.measure and not wanted.needs_pixels else found)


def _measured(chosen: Iterable[ChosenView], measure: Measure) -> list[ChosenView]:
    return [ChosenView(s.view, s.facts, measure(s.view), s.minus) for s in chosen]


def _require_light(key: str, light: str | None, facts: Iterable[FrameFacts]) -> None:
    if light is None:
        return
    known = sorted({f.light for f in facts if f.light})
    if light not in known:
        names = ", ".join(known) if known else "none, because its rows have no named lights"
        raise InputError.field("component images", key, light, f"one of the lights of this run: {names}")


def _require_directions(views: Iterable[View]) -> None:
    for view in views:
        if view.angle_deg is None:
            raise StateError(
                f"the direction from which camera {view.camera} sees a component is not known: its calibration states "
                "no working distance.",
                action="Add working_distance_mm to the calibration, or select without direction.",
                code="no-working-distance",
            )


def _is_seen_from(view: View, bounds: Bounds, choice: Choice) -> bool:
    angle = view.angle_deg
    if angle is None or not bounds.min_angle_deg <= angle <= bounds.max_angle_deg:
        return False
    if choice.seen_from is None:
        return True
    by_side = isinstance(choice.seen_from, str)
    azimuth = view.picture_azimuth_deg if by_side else view.azimuth_deg
    if azimuth is None:
        return False
    wanted = AZIMUTHS[choice.seen_from] if isinstance(choice.seen_from, str) else choice.seen_from
    within_deg = WITHIN_DEG if choice.within_deg is None else choice.within_deg
    return abs((azimuth - wanted + 180) % 360 - 180) <= within_deg


def _is_exposed(facts: FrameFacts, bounds: Bounds) -> bool:
    if bounds.min_exposure_us is None and bounds.max_exposure_us is None:
        return True
    if facts.exposure_us is None:
        return False
    low, high = bounds.min_exposure_us or 0.0, bounds.max_exposure_us
    return low <= facts.exposure_us and (high is None or facts.exposure_us <= high)


def _is_good(measures: Measures | None, bounds: Bounds) -> bool:
    sharpness = measures.sharpness_per_mm if measures else None
    saturated = measures.saturated if measures else None
    if bounds.min_sharpness_per_mm is not None and (sharpness is None or sharpness < bounds.min_sharpness_per_mm):
        return False
    return bounds.max_saturated is None or (saturated is not None and saturated <= bounds.max_saturated)


def _sharpness_rank(choice: ChosenView) -> tuple[float, float, float]:
    measures = choice.measures or Measures(None, None)
    saturated = 1.0 if measures.saturated is None else measures.saturated
    return -round(choice.view.coverage / 0.05), round(saturated / 0.01), -(measures.sharpness_per_mm or 0.0)


def _nearest(choice: ChosenView, others: list[ChosenView]) -> ChosenView:
    """Return the one that sees the component most nearly from the same direction; the best one if none is known."""
    sight = _unit(choice.view)
    return max(others, key=lambda o: float(np.nan_to_num(sight @ _unit(o.view))))


def _unit(view: View) -> np.ndarray:
    return np.asarray(view.toward / np.linalg.norm(view.toward))
