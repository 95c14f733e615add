"""A stitched run with its recorded frames: matrices, verdict, and images of components."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError, NotFoundError, StateError
from vaoi_station.files import Recording, write_stitch
from vaoi_station.geometry import Camera, apply
from vaoi_station.geometry.displacement import PARAMETERS, displace_camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.library.arguments import require_path, require_text, whole
from vaoi_station.library.component_images import ComponentImage, ComponentImages
from vaoi_station.model import BoardType, Component, Status, Stitch
from vaoi_station.rendering import View, ViewCalculator, render

_SAME_PX = 0.01
"""Largest difference in a frame, px, of two equal calibrations: results state displacements with four decimals."""


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


def component_height(result: Stitch, ref: str) -> tuple[float | None, float | None]:
    """Return the estimated height of a component above the board and its standard deviation, mm."""
    return _figure(result, "heights_mm", ref), _figure(result, "height_sigma_mm", ref)


def _figure(result: Stitch, key: str, ref: str) -> float | None:
    figures = result.quality.get(key, {})
    value = figures.get(ref) if isinstance(figures, dict) else str(figures)
    if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
        raise InputError.field("the result", f"quality.{key}", value, "an object of numbers by ref")
    return value


@dataclass(frozen=True, eq=False)
class StitchedRun:
    """A recording with its result, which gives the positions and images of its components."""

    recording: Recording
    cameras: tuple[Camera, ...]
    board_type: BoardType | None
    result: Stitch

    @property
    def status(self) -> Status:
        """The verdict of the run: ok, degraded or failed."""
        return self.result.status

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reasons for a verdict other than ok, in sentences."""
        return self.result.reasons

    @property
    def refs(self) -> tuple[str, ...]:
        """Addresses of all components of the board type, e.g. `U1` or, on a panel, `2/U1`."""
        return () if self.board_type is None else tuple(c.address for c in self.board_type.components)

    @property
    def cad_matrix(self) -> Floats | None:
        """CAD matrix C (3, 3), from CAD to tester coordinates; None if the result has no CAD mapping."""
        return self.result.cad_matrix

    def image_matrix(self, camera: int, row: int) -> Floats | None:
        """Return image matrix M_ij (3, 3), from tester to undistorted pixels; None if the frame was not placed."""
        check_frame_index(camera, row, len(self.cameras), len(self.result.row_motion), self.recording.directory)
        return self.result.image_matrices[camera][row]

    def component(self, ref: str, *, px_per_mm: float | None = None, min_coverage: float = 0.5) -> ComponentImages:
        """Return the images of a component from every frame that shows it.

        Args:
            ref: address of the component.
            px_per_mm: resolution; by default that of the cameras.
            min_coverage: frames that show a smaller share of the component are left out.

        Raises:
            InputError: `px_per_mm` is not 0.1 to 1000 or gives too large an image, or `min_coverage` is not 0 to 1.
            NotFoundError: the board type has no such component.
            StateError: the run has no board type or no CAD mapping.
        """
        require_text("component", "ref", ref)
        views = self._views.compute(self._part(ref), px_per_mm=px_per_mm, min_coverage=min_coverage)
        covariances = component_covariances(self.result, ref)
        height, sigma = component_height(self.result, ref)
        # Views are matched by frame; a centre outside its frame has a view but no covariance.
        # A row with one good frame has matrices for all cameras, also for those whose frame never arrived.
        missing = set(self.recording.head.missing)
        images = tuple(
            self._image(view, covariances.get((view.camera, view.row)))
            for view in views
            if (view.camera, view.row) not in missing
        )
        return ComponentImages(ref, images, height, sigma, self.status)

    def center(self, ref: str) -> tuple[float, float]:
        """Return the centre of a component in CAD coordinates, in the unit of the board type."""
        require_text("center", "ref", ref)
        return self._part(ref).center

    def save(self, path: str | Path) -> None:
        """Write the result in the format of `docs/formats.md`, atomically: the file is complete or unchanged."""
        write_stitch(require_path("save", "path", path), self.result)

    @property
    def _board_type(self) -> BoardType:
        if self.board_type is None:
            raise StateError("this run has no board type.", action="Open the recording with board_type=PATH.")
        return self.board_type

    def _part(self, ref: str) -> Component:
        part = self._board_type.component(ref)
        if part is None:
            # A board type may have thousands of components; a few are enough to show the form of an address.
            known = ", ".join(self.refs[:8])
            raise NotFoundError(
                f"board type {self._board_type.name!r} has no component {ref!r}.", action=f"It has {known} …"
            )
        return part

    @cached_property
    def _views(self) -> ViewCalculator:
        return ViewCalculator(self._board_type, self.result, self.cameras)

    def _image(self, view: View, covariance: Floats | None) -> ComponentImage:
        def load() -> NDArray[Any]:
            frame = self.recording.frame(view.camera, view.row)
            assert frame is not None  # views of missing frames are left out
            return render(view, frame)

        return ComponentImage(
            camera=view.camera,
            row=view.row,
            coverage=view.coverage,
            px_per_mm=view.px_per_mm,
            crop_from_cad=view.crop_matrix,
            image_from_crop=view.matrix,
            distorted=view.distorted,
            covariance_px2=covariance,
            _load=load,
        )


def check_frame_index(camera: int, row: int, cameras: int, rows: int, name: str | Path) -> None:
    """Raise InputError with the limits if a run has no frame of this camera and row."""
    i, j = whole(camera), whole(row)
    if i is None or j is None or not (0 <= i < cameras and 0 <= j < rows):
        raise InputError(
            f"{name}: has no frame of camera {camera!r}, row {row!r}; cameras are 0 … {cameras - 1}, "
            f"rows 0 … {rows - 1}."
        )


def check_result(result: Stitch, rows: int, cameras: Sequence[Camera], name: str | Path) -> None:
    """Refuse a result that belongs to another recording or another calibration.

    Raises:
        InputError: the number of cameras or rows differs, or M_i0 is not N_i with the displacement that the result
            states.
    """
    n, m = len(result.image_matrices), len(result.row_motion)
    if (n, m) != (len(cameras), rows):
        raise _other_recording(
            name, f"it has {n} cameras and {m} rows, the recording has {len(cameras)} cameras and {rows} rows"
        )
    for i, (matrices, camera) in enumerate(zip(result.image_matrices, _as_in_run(result, cameras), strict=True)):
        first = matrices[0]
        # M_i0 equals N_i in every result (docs/conventions.md, gauge). So a difference means another calibration.
        if first is not None and _apart_px(first, camera) > _SAME_PX:
            raise _other_recording(name, f"camera {i} has another calibration")


def _as_in_run(result: Stitch, cameras: Sequence[Camera]) -> Sequence[Camera]:
    """Return the cameras with the displacements that the result states; as calibrated if it states none."""
    try:
        displacement_px = np.array(result.quality.get("camera_displacement_px"), dtype=np.float64)
    except (TypeError, ValueError):  # from a file, whose `quality` is not checked
        return cameras
    if displacement_px.shape != (len(cameras), PARAMETERS) or not np.isfinite(displacement_px).all():
        return cameras
    return [displace_camera(camera, d) for camera, d in zip(cameras, displacement_px, strict=True)]


def _apart_px(matrix: Floats, camera: Camera) -> float:
    """Return the largest distance at the corners of a camera's frame between its N_i and a matrix, px."""
    w, h = camera.width_px - 1, camera.height_px - 1
    corners = np.array([(0, 0), (w, 0), (w, h), (0, h)], dtype=np.float64)
    image_from_image = np.asarray(matrix) @ np.linalg.inv(camera.image_from_row.matrix)
    return float(np.abs(apply(image_from_image, corners) - corners).max())


def _other_recording(name: str | Path, difference: str) -> InputError:
    return InputError(f"{name}: belongs to another recording: {difference}.", action="Stitch this recording again.")
