"""The temporary images of one component of a run, as a request describes them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Component, Stitch
from vaoi_station.model.stitch_result import BodyHeight, body_height
from vaoi_station.rendering.request import ImageRequest
from vaoi_station.rendering.selection import ChosenView, FrameFacts, Measure, select
from vaoi_station.rendering.temporary import render, subtract
from vaoi_station.rendering.views import ViewCalculator


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


def choose_images(
    calculator: ViewCalculator,
    part: Component,
    run: tuple[BoardType, Stitch],
    frames: tuple[Collection[tuple[int, int]], Mapping[tuple[int, int], FrameFacts]],
    wanted: ImageRequest,
    measure: Measure,
) -> ChosenImages:
    """Compute the views of a component, and choose among them.

    Args:
        calculator: calculator of the run's views.
        part: the component.
        run: board type and complete result of the run.
        frames: the frames (camera, row) that may be used, and how all frames were taken.
        wanted: the request.
        measure: function that measures a view.

    Raises:
        InputError: a picture would be too large, or the run has no frame under a light that the request names.
        StateError: the request names a direction, and directions are not known.
    """
    return choose_all(calculator, [part], run, frames, wanted, measure)[0]


def choose_all(
    calculator: ViewCalculator,
    parts: Sequence[Component],
    run: tuple[BoardType, Stitch],
    frames: tuple[Collection[tuple[int, int]], Mapping[tuple[int, int], FrameFacts]],
    wanted: ImageRequest,
    measure: Measure,
) -> list[ChosenImages]:
    """Choose the images of several components, in their order; see `choose_images`.

    The views of all components are computed at once, which takes a fraction of the time of one by one.
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
    image = render(choice.view, frame)
    if choice.minus is None or other is None:
        return image
    return subtract(image, render(choice.minus.view, other), choice.ratio)


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
