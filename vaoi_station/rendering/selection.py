"""The selection of temporary images by light, direction, exposure and quality, and their order.

*Best first* means: the largest share of the footprint (in steps of 0.001), then the smallest distance from the centre
of the frame, where the component is seen most nearly from above; equal ones by row and camera. *Sharpest first* means:
the largest share of the footprint in steps of 5 %, then the smallest share of saturated pixels in steps of 1 %, then
the greatest sharpness.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError, StateError
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Component, RecordingHead, Stitch
from vaoi_station.model.stitch_result import BodyHeight, body_height
from vaoi_station.photometry import FlatFields, WhiteBalance
from vaoi_station.rendering.request import AZIMUTHS, WITHIN_DEG, Bounds, Choice, ImageRequest
from vaoi_station.rendering.temporary import render, subtract
from vaoi_station.rendering.views import View, ViewCalculator, sigma_px

_LEAST_PIXELS = 9
"""Least number of pixels that are measured; fewer have no gradient worth a figure."""
_SOBEL = 8.0
"""Sum of the positive weights of the Sobel operator times the distance that they span: it gives grey levels per px."""
_SOBEL_NOISE = 2 * 12 / _SOBEL**2
"""Sum of the squared weights of both Sobel operators: share of the noise's variance in the squared gradient."""
_NOISE_MASK = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
"""A mask that answers to noise, and hardly to edges (Immerkær 1996, Computer Vision and Image Understanding 64)."""
_MEDIAN = 0.6745
"""Median of the magnitude of a normal variable, in standard deviations."""


class Measures(NamedTuple):
    """How well a frame shows a component."""

    sharpness_per_mm: float | None
    """Root mean square of the gradient, divided by the standard deviation of the grey levels, 1/mm.

    This is the mean spatial frequency of what the frame shows. It falls with every blur, and does not depend on
    exposure and gain as long as nothing is saturated. It is None where the footprint has a single grey level.
    """
    saturated: float | None
    """Share of the footprint's pixels that have the largest value that the frame can have; None without a pixel."""


def measure(view: View, frame: NDArray[Any]) -> Measures:
    """Measure the frame inside the footprint of the view's component."""
    height, width = frame.shape[:2]
    # One pixel around the footprint, for the gradients at its edge.
    x0, y0 = (max(math.floor(v) - 1, 0) for v in view.outline_px.min(0).tolist())
    x1, y1 = (
        min(math.ceil(v) + 2, most) for v, most in zip(view.outline_px.max(0).tolist(), (width, height), strict=True)
    )
    if x1 - x0 < 3 or y1 - y0 < 3:
        return Measures(None, None)
    part = frame[y0:y1, x0:x1]
    return _measure(part, _inside(view.outline_px - (x0, y0), part.shape[:2]), view.frame_px_per_mm)


def _inside(outline_px: Floats, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return which pixels of a part of a frame (h, w) lie in a polygon."""
    mask = np.zeros(shape, np.uint8)
    cv2.fillConvexPoly(mask, np.round(outline_px * 16).astype(np.int32), 1, shift=4)
    return mask.astype(bool)


def _measure(part: NDArray[Any], inside: NDArray[np.bool_], px_per_mm: float) -> Measures:
    count = int(inside.sum())
    if count < _LEAST_PIXELS:
        return Measures(None, None)
    at_limit = part == np.iinfo(part.dtype).max
    saturated = float((at_limit if part.ndim == 2 else at_limit.any(2))[inside].mean())
    grey = np.asarray(part if part.ndim == 2 else cv2.cvtColor(part, cv2.COLOR_BGR2GRAY), dtype=np.float32)
    x = cv2.Sobel(grey, cv2.CV_32F, 1, 0, scale=1 / _SOBEL)[inside]
    y = cv2.Sobel(grey, cv2.CV_32F, 0, 1, scale=1 / _SOBEL)[inside]
    # Noise has a gradient as well: without this, a darker frame would be the sharper one.
    answer = np.abs(cv2.filter2D(grey, cv2.CV_32F, _NOISE_MASK)[inside])
    noise = (float(np.median(answer)) / _MEDIAN) ** 2 / float((_NOISE_MASK**2).sum())
    gradient = float((x * x + y * y).mean()) - _SOBEL_NOISE * noise
    variance = float(grey[inside].var(dtype=np.float64)) - noise
    if variance <= max(noise / math.sqrt(count), 1e-9):
        return Measures(None, saturated)
    return Measures(math.sqrt(max(gradient, 0.0) / variance) * px_per_mm, saturated)


Measure = Callable[[View], "Measures | None"]
"""Function that measures a view's frame; it returns None if the frame is no longer available."""


class FrameFacts(NamedTuple):
    """What is known about how a frame was taken."""

    exposure_us: float | None = None
    gain: float | None = None
    light: str | None = None
    time_s: float | None = None
    """Time of the row's pulse after that of row 0."""
    white_balance: WhiteBalance | None = None
    """What makes white things grey in its pictures; None without flat fields that know it."""

    def brightness_to(self, other: FrameFacts) -> float:
        """Return how much brighter a picture is than another one of the same scene.

        If exposures are not known, only the balance of colours counts.
        """
        own, others = (1.0 if b is None else b.brightness for b in (self.white_balance, other.white_balance))
        if self.exposure_us is None or other.exposure_us is None:
            return own / others
        return self.exposure_us * (self.gain or 1.0) * own / (other.exposure_us * (other.gain or 1.0) * others)


def frame_facts(head: RecordingHead, fields: FlatFields | None = None) -> dict[tuple[int, int], FrameFacts]:
    """Return how each frame (camera, row) of a recording was taken. `fields` are flat fields that fit it."""
    balances = fields.white_balances if fields is not None else {}
    times_s = (head.row_times_s() - head.row_times_s()[0]).tolist()
    lights = head.lights or ("",) * head.rows
    return {
        (i, j): FrameFacts(
            head.exposure_us(i, j), head.gain(i, j), lights[j] or None, times_s[j], balances.get((i, lights[j] or None))
        )
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


@dataclass(frozen=True, eq=False)
class ChosenImages:
    """The temporary images of one component that a request asks for."""

    part: Component
    chosen: tuple[ChosenView, ...]
    height: BodyHeight | None
    """Height of the plane in which the images are right; None for the board's plane."""
    remark: str | None
    """Why the images lie in another plane than requested; None if they do not."""

    def covariance_px2(self, choice: ChosenView, of_centre: Any) -> Floats | None:
        """Return the covariance (2, 2) of the component's place in a frame, px²; None if it is not known.

        `of_centre` is the covariance (2, 2) of its centre on the board's surface, from the result, or None.
        """
        flat = None if of_centre is None else np.array(of_centre, dtype=np.float64)
        return choice.view.covariance_px2(flat, (self.height.sigma_mm or 0.0) if self.height else 0.0)


def choose_all(
    calculator: ViewCalculator,
    parts: Sequence[Component],
    run: tuple[BoardType, Stitch],
    frames: tuple[Collection[tuple[int, int]], Mapping[tuple[int, int], FrameFacts]],
    wanted: ImageRequest,
    measure: Measure,
) -> list[ChosenImages]:
    """Compute the views of components, and choose the images of each; all at once takes a fraction of the time.

    Raises:
        InputError: a picture would be too large, or the run has no frame under a light that the request names.
        StateError: the request names a direction, and directions are not known.
    """
    heights: dict[str, BodyHeight] = {}
    remarks: dict[str, str] = {}
    if wanted.framing.plane == "top":
        for part in parts:
            height = body_height(part, *run)
            remark = plane_remark(part, height, calculator.knows_heights)
            if remark is not None:
                remarks[part.address] = remark
            elif height is not None:
                heights[part.address] = height
    views = calculator.compute_all(
        parts,
        min_coverage=wanted.bounds.min_coverage,
        framing=wanted.framing,
        heights_mm={address: height.mm for address, height in heights.items()},
    )
    usable, facts = frames
    found = []
    for part in parts:
        of_part = [v for v in views[part.address] if (v.camera, v.row) in usable]
        chosen = select(of_part, facts, wanted, measure)
        found.append(ChosenImages(part, chosen, heights.get(part.address), remarks.get(part.address)))
    return found


def render_chosen(choice: ChosenView, frame: NDArray[Any], other: NDArray[Any] | None = None) -> NDArray[Any]:
    """Render one temporary image. `other` is the frame of the image that is subtracted, if there is one."""
    image = render(choice.view, frame, choice.facts.white_balance)
    if choice.minus is None or other is None:
        return image
    return subtract(image, render(choice.minus.view, other, choice.minus.facts.white_balance), choice.ratio)


def plane_remark(part: Component, height: BodyHeight | None, cameras_know: bool) -> str | None:
    """Return why images that were requested in the plane of the body's top lie on the board; None if they do not.

    `cameras_know` is whether the calibration states the working distance of the cameras.
    """
    if not cameras_know:
        return (
            "The calibration states no working_distance_mm, so a height has no known effect: the images are right in "
            "the plane of the board."
        )
    if height is None:
        return (
            f"{part.address} has no height: the run measured none, and the board type states no body_height. Its "
            "images are right in the plane of the board."
        )
    return None


def component_covariances(result: Stitch, ref: str) -> dict[tuple[int, int], Floats]:
    """Return the covariance (2, 2) in px² of a component's centre in each frame, by (camera, row)."""
    try:
        rows = result.quality.get("component_covariance_px2", {}).get(ref, [])
        return {(int(c), int(j)): np.array([[xx, xy], [xy, yy]], dtype=np.float64) for c, j, xx, xy, yy in rows}
    except (AttributeError, TypeError, ValueError) as error:
        # `quality` accepts any keys and values, so that readers of older versions can open newer results.
        raise InputError(
            f"the result: quality.component_covariance_px2 of {ref!r} is not a list of [camera, row, xx, xy, yy].",
            action="Stitch the recording again.",
        ) from error


def describe(choice: ChosenView, covariance_px2: Floats | None) -> dict[str, Any]:
    """Return the figures and matrices of one temporary image; docs/rest.md defines each.

    `covariance_px2` (2, 2) is that of the component's place in the frame, px²; None if it is not known. Figures that
    are not known are None.
    """
    view, facts, measures = choice.view, choice.facts, choice.measures or Measures(None, None)
    sigma = sigma_px(covariance_px2)
    return {
        "camera": view.camera,
        "row": view.row,
        "coverage": view.coverage,
        "off_center": view.off_center,
        "width_px": view.width,
        "height_px": view.height,
        "px_per_mm": view.px_per_mm,
        "covariance_px2": None if covariance_px2 is None else covariance_px2.tolist(),
        "sigma_px": sigma,
        "sigma_mm": None if sigma is None else sigma / view.frame_px_per_mm,
        "view_azimuth_deg": view.azimuth_deg,
        "view_angle_deg": view.angle_deg,
        "sharpness_per_mm": measures.sharpness_per_mm,
        "saturated": measures.saturated,
        "time_s": facts.time_s,
        "exposure_us": facts.exposure_us,
        "gain": facts.gain,
        "light": facts.light,
        "white_balance": None if facts.white_balance is None else facts.white_balance.gains,
        "crop_from_cad": view.crop_matrix.tolist(),
        "cad_from_crop": np.linalg.inv(view.crop_matrix).tolist(),
        "image_from_crop": view.matrix.tolist(),
        "plane": view.plane,
        "height_mm": view.height_mm,
        "minus": None if choice.minus is None else (choice.minus.view.camera, choice.minus.view.row),
        "distorted": view.distorted,
    }
