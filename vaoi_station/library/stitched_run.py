"""A stitched run with its recorded frames: matrices, verdict, and images of components."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from vaoi_station.board_check.checked import CheckedBoardType, checked_board_type
from vaoi_station.board_check.run_frames import CheckedRun
from vaoi_station.errors import InputError, NotFoundError, StateError
from vaoi_station.files import Recording, write_stitch
from vaoi_station.geometry import Camera, apply
from vaoi_station.geometry.displacement import PARAMETERS, displace_camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.library.arguments import require_path, require_text, whole
from vaoi_station.library.component_images import FIELDS, ComponentImage, ComponentImages
from vaoi_station.model import BoardType, Component, Status, Stitch
from vaoi_station.rendering import (
    ChosenImages,
    ChosenView,
    FrameFacts,
    ImageOptions,
    ImageRequest,
    Measures,
    View,
    ViewCalculator,
    choose_images,
    measure,
    render_all,
    render_chosen,
)
from vaoi_station.rendering.description import component_covariances, describe
from vaoi_station.rendering.selection import frame_facts

_SAME_PX = 0.01
"""Largest difference in a frame, px, of two equal calibrations: results state displacements with four decimals."""


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

    def component_matrix(self, ref: str) -> Floats | None:
        """Return C (3, 3) of a component: its own, that of its board on a panel, or C; None without a CAD mapping.

        Raises:
            NotFoundError: the board type has no such component.
        """
        require_text("component_matrix", "ref", ref)
        return self.result.component_matrix(self._part(ref).address)

    def image_matrix(self, camera: int, row: int) -> Floats | None:
        """Return image matrix M_ij (3, 3), from tester to undistorted pixels; None if the frame was not placed."""
        check_frame_index(camera, row, len(self.cameras), len(self.result.row_motion), self.recording.directory)
        return self.result.image_matrices[camera][row]

    def component(self, ref: str, **options: Unpack[ImageOptions]) -> ComponentImages:
        """Return the images of a component from every frame that shows it.

        Args:
            ref: address of the component.
            **options: `px_per_mm`, `margin_mm`, `align` ("cad", "part") and `plane` ("board", "top") frame the images;
                `light`, `seen_from` with `within_deg`, and bounds of coverage, exposure, angle, sharpness and
                saturation choose them; `order` ("best", "sharpest") and `limit` follow; `minus` subtracts another
                light; `measure` measures sharpness and saturation of each. docs/rest.md describes all of them.

        Raises:
            InputError: an option is outside its limits or gives too large an image, or the run has no such light.
            NotFoundError: the board type has no such component.
            StateError: the run has no board type or no CAD mapping, or a direction is wanted and not known.
        """
        require_text("component", "ref", ref)
        chosen = self.choose(ref, ImageRequest.of(options))
        covariances = component_covariances(self.result, ref)
        height, sigma = component_height(self.result, ref)
        # Images are matched by frame; a centre outside its frame has an image but no covariance.
        images = tuple(
            self._image(choice, chosen.covariance_px2(choice, covariances.get((choice.view.camera, choice.view.row))))
            for choice in chosen.chosen
        )
        return ComponentImages(ref, images, height, sigma, self.status, chosen.remark)

    def all_pictures(
        self, *, px_per_mm: float | None = None, min_coverage: float = 0.5
    ) -> dict[str, list[NDArray[Any]]]:
        """Return the pictures of all components by address, those of one as in `component(ref).images`.

        All are rendered at once, frame by frame, in a fraction of the time of one component after the other. Pictures
        of one frame are parts of one array.

        Raises:
            InputError: an option is outside its limits or gives too large a picture.
            StateError: the run has no board type or no CAD mapping.
        """
        parts, missing = self._board_type.components, set(self.recording.head.missing)
        table = self._views.compute_all(parts, px_per_mm=px_per_mm, min_coverage=min_coverage)
        made = render_all(table, lambda i, j: None if (i, j) in missing else self.recording.frame(i, j))
        found: dict[str, list[NDArray[Any]]] = {address: [] for address in table.addresses}
        for n, picture in zip(table.columns.component.tolist(), made, strict=True):
            if picture is not None:
                found[table.addresses[n]].append(picture)
        return found

    def choose(self, ref: str, wanted: ImageRequest) -> ChosenImages:
        """Choose the images of a component that a request asks for; see `component`."""
        # A row with one good frame has matrices for all cameras, also for those whose frame never arrived.
        frames = set(self._facts) - set(self.recording.head.missing)
        run = self._board_type, self.result
        return choose_images(self._views, self._part(ref), run, (frames, self._facts), wanted, self._measure)

    def center(self, ref: str) -> tuple[float, float]:
        """Return the centre of a component in CAD coordinates, in the unit of the board type."""
        require_text("center", "ref", ref)
        return self._part(ref).center

    def check_board_type(self, board_type: BoardType) -> CheckedBoardType:
        """Lay a board type over this run, which may have been stitched with another one, and compare it.

        Returns:
            Shift, rotation, mirror and scale of its components against the pictures, those that do not look as if they
            were there, and the corrected board type.

        Raises:
            InputError: the board type has too few components, or is larger than what was filmed.
            StateError: the run has no placed frame.
        """
        cameras, recording = self.result.cameras(self.cameras), self.recording
        lights = recording.head.lights or ()
        run = CheckedRun(self.result, cameras, recording.frame, lights, self.board_type)
        return checked_board_type(run, board_type)

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

    @cached_property
    def _facts(self) -> dict[tuple[int, int], FrameFacts]:
        """How each frame (camera, row) was taken."""
        return frame_facts(self.recording.head)

    def _measure(self, view: View) -> Measures:
        return measure(view, self._frame(view))

    def _frame(self, view: View) -> NDArray[Any]:
        frame = self.recording.frame(view.camera, view.row)
        assert frame is not None  # views of missing frames are left out
        return frame

    def load(self, choice: ChosenView) -> NDArray[Any]:
        """Read the frames of a chosen image, and render it."""
        other = None if choice.minus is None else self._frame(choice.minus.view)
        return render_chosen(choice, self._frame(choice.view), other)

    def _image(self, choice: ChosenView, covariance: Floats | None) -> ComponentImage:
        known = describe(choice, covariance)
        fields: dict[str, Any] = {name: known[name] for name in FIELDS}
        fields |= {"crop_from_cad": choice.view.crop_matrix, "image_from_crop": choice.view.matrix}
        return ComponentImage(**fields, covariance_px2=covariance, _load=lambda: self.load(choice))


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
