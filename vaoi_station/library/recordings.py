"""Recordings on disk, simulated or filmed: opened with calibration and board type, stitched, and their images cut."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal, Unpack

import numpy as np
from numpy.typing import NDArray

from vaoi_station.board_check.check import CheckedBoardType, checked_board_type
from vaoi_station.board_check.overview import CheckedRun
from vaoi_station.clamping import Clamped, FilmedBoard, clamp, request_of
from vaoi_station.errors import InputError, NotFoundError, StateError
from vaoi_station.files import Recording, read_stitch, write_stitch
from vaoi_station.geometry import Camera, apply
from vaoi_station.geometry.displacement import PARAMETERS, displaced_cameras
from vaoi_station.geometry.transforms import Floats
from vaoi_station.library.arguments import require_path, require_text, require_whole, whole
from vaoi_station.library.component_images import ComponentImages, component_height, made_image
from vaoi_station.model import BoardType, Calibration, Component, Status, Stitch
from vaoi_station.photometry import FlatFields
from vaoi_station.rendering import (
    ChosenImages,
    ChosenView,
    FrameFacts,
    ImageOptions,
    ImageRequest,
    Measures,
    View,
    ViewCalculator,
    choose_all,
    measure,
    render_all,
    render_chosen,
)
from vaoi_station.rendering.selection import component_covariances, describe, frame_facts
from vaoi_station.stitching.paper_method import stitch_by_paper
from vaoi_station.stitching.recordings.opening import OpenedRun, open_run
from vaoi_station.stitching.recordings.origin import check_origin, with_origin
from vaoi_station.stitching.work import stitch_frames

Method = Literal["auto", "features", "fiducials", "reference", "paper"]
METHODS: tuple[Method, ...] = ("auto", "features", "fiducials", "reference", "paper")
_SAME_PX = 0.01
"""Largest difference in a frame, px, of two equal calibrations: results state displacements with four decimals."""


@dataclass(frozen=True)
class RecordedRun:
    """The recording of one board: frames, calibration, board type. Frames are read from disk on request."""

    directory: Path
    calibration_path: Path | None
    board_path: Path | None
    reference_path: Path | None
    rotation_deg: int | None
    """Expected rotation of the board, in degrees; None for that of the recording."""
    _opened: OpenedRun

    @property
    def cameras(self) -> int:
        """Number of cameras."""
        return len(self._opened.recording.head.cameras)

    @property
    def rows(self) -> int:
        """Number of rows: one for each trigger pulse."""
        return self._opened.recording.head.rows

    @property
    def calibration(self) -> Calibration:
        """Camera matrices N_i and lenses."""
        return self._opened.calibration

    @property
    def board_type(self) -> BoardType | None:
        """CAD data of the board; None if the recording has no board type."""
        return self._opened.setup.board_type

    def frame(self, camera: int, row: int) -> NDArray[Any] | None:
        """Read one frame, (height, width) or (height, width, 3); None if the frame never arrived."""
        check_frame_index(camera, row, self.cameras, self.rows, self.directory)
        return self._opened.recording.frame(camera, row)

    def frames(self) -> Iterator[tuple[int, int, NDArray[Any]]]:
        """Yield camera, row and pixels of every frame that arrived, row by row."""
        for row in range(self.rows):
            for camera in range(self.cameras):
                pixels = self.frame(camera, row)
                if pixels is not None:
                    yield camera, row, pixels

    def stitch(self, method: Method = "auto") -> StitchedRun:
        """Stitch the recording; docs/how-to/stitch.md describes the methods. InputError: it needs a reference."""
        if method not in METHODS:
            raise InputError(f"method is {method!r}, but must be one of {', '.join(METHODS)}.")
        # The paper's method replaces the station's stitching below, and ignores the kind of evidence, which is part of
        # the set-up that an opened run holds.
        opened = open_run(
            self.directory,
            calibration=self.calibration_path,
            board=self.board_path,
            reference=self.reference_path,
            method="auto" if method == "paper" else method,
            rotation_deg=self.rotation_deg,
        )
        recording = opened.recording
        if method == "paper":
            result = stitch_by_paper(opened.setup, recording.head, recording.frame)
        else:
            reference = opened.reference.recording.frame if opened.reference else None
            result = stitch_frames(opened.setup, recording.head, recording.frame, reference)
        return self._with(with_origin(result, recording, opened.calibration, self.board_type))

    def with_result(self, result: Stitch | str | Path) -> StitchedRun:
        """Combine the recording with a result, or a result file, of an earlier stitch.

        InputError: it belongs to another recording, calibration or board type. Results that `stitch` or `vaoi stitch`
        made are checked by pixels and documents, others by calibration and numbers of cameras and rows only.
        """
        if isinstance(result, Stitch):
            stitch, name = result, "the result"
        else:
            path = require_path("with_result", "result", result)
            stitch, name = read_stitch(path), str(path)
        check_result(stitch, self.rows, self._opened.setup.cameras, name)
        check_origin(stitch, self._opened.recording, self.calibration, self.board_type, name)
        return self._with(stitch)

    def _with(self, stitch: Stitch) -> StitchedRun:
        return StitchedRun(self._opened.recording, self._opened.setup.cameras, self.board_type, stitch)


def open_recording(
    directory: str | Path,
    *,
    calibration: str | Path | None = None,
    board_type: str | Path | None = None,
    reference: str | Path | None = None,
    rotation_deg: int | None = None,
) -> RecordedRun:
    """Open a recording (docs/formats.md).

    Args:
        directory: the recording.
        calibration: calibration.json; by default the one in the directory.
        board_type: board.json; by default the one in the directory, if there is one.
        reference: directory made by `vaoi teach`; stitching then uses it as well.
        rotation_deg: expected rotation of the board, 0, 90, 180 or 270; by default that of the recording.

    Raises:
        InputError: an argument is not a path or rotation, or a file is missing, malformed, or does not fit the others.
    """
    case = require_path("open_recording", "directory", directory)
    given = {"calibration": calibration, "board_type": board_type, "reference": reference}
    calibration_path, board_path, reference_path = (
        None if path is None else require_path("open_recording", name, path) for name, path in given.items()
    )
    opened = open_run(
        case, calibration=calibration_path, board=board_path, reference=reference_path, rotation_deg=rotation_deg
    )
    return RecordedRun(case, calibration_path, board_path, reference_path, rotation_deg, opened)


def stitch(recording: str | Path | RecordedRun, method: Method = "auto") -> StitchedRun:
    """Stitch a recording, given as a directory or as a `RecordedRun`."""
    run = recording if isinstance(recording, RecordedRun) else open_recording(recording)
    return run.stitch(method)


def simulate(scenario: str | Path, directory: str | Path, *, board: int = 0) -> RecordedRun:
    """Record one board of the digital twin, with calibration, board type and truth.json.

    Args:
        scenario: a scenario file (TOML), or the name of one that comes with the package, e.g. "small" or "demo".
            A file takes precedence over a shipped scenario of the same name; a folder does not.
        directory: directory for the recording; it must not contain one already.
        board: index of the board; boards of one scenario differ in noise, motion and faults.

    Raises:
        InputError: an argument is not of its type, the scenario is malformed, or the directory already holds a
            recording.
        NotFoundError: there is no such scenario.
    """
    from vaoi_station.simulation import Twin, find_scenario, read_scenario
    from vaoi_station.simulation.recording_writer import write_passage

    require_path("simulate", "scenario", scenario)
    out = require_path("simulate", "directory", directory)
    require_whole("simulate", "board", board, 0, 1_000_000)
    if (out / "recording.json").exists():
        raise InputError(f"{out}: already holds a recording.", action="Give another directory, or remove this one.")
    twin = Twin(read_scenario(find_scenario(scenario)))
    write_passage(twin.passage(board), out)
    return open_recording(out)


@dataclass(frozen=True, eq=False)
class StitchedRun:
    """A recording with its result, which gives the positions and images of its components."""

    recording: Recording
    cameras: tuple[Camera, ...]
    board_type: BoardType | None
    result: Stitch
    flat_fields: FlatFields | None = None
    """Flat fields of the array, which balance the colours of images."""

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
            **options: the fields of `ImageOptions`, which docs/rest.md describes ("Choosing images").

        Raises:
            InputError: an option is outside its limits or gives too large an image, or the run has no such light.
            NotFoundError: the board type has no such component.
            StateError: the run has no board type or no CAD mapping, or a direction is wanted and not known.
        """
        require_text("component", "ref", ref)
        chosen = self.choose(ref, ImageRequest.of(options))
        covariances = component_covariances(self.result, ref)
        height, sigma = component_height(self.result, ref)
        images = []
        for choice in chosen.chosen:
            # A centre outside its frame has an image but no covariance.
            covariance_px2 = chosen.covariance_px2(choice, covariances.get((choice.view.camera, choice.view.row)))
            images.append(made_image(describe(choice, covariance_px2), partial(self.load, choice)))
        return ComponentImages(ref, tuple(images), height, sigma, self.status, chosen.remark)

    def all_pictures(
        self, *, px_per_mm: float | None = None, min_coverage: float = 0.5
    ) -> dict[str, list[NDArray[Any]]]:
        """Return the pictures of all components by address, those of one as in `component(ref).images`.

        All are rendered frame by frame, so that each is read once.
        """
        parts, missing = self._board_type.components, set(self.recording.head.missing)
        table = self._views.compute_all(parts, px_per_mm=px_per_mm, min_coverage=min_coverage)
        made = render_all(table, lambda i, j: None if (i, j) in missing else self.recording.frame(i, j))
        found: dict[str, list[NDArray[Any]]] = {address: [] for address in table.addresses}
        for n, picture in zip(table.component.tolist(), made, strict=True):
            if picture is not None:
                found[table.addresses[n]].append(picture)
        return found

    def choose(self, ref: str, wanted: ImageRequest) -> ChosenImages:
        """Choose the images of a component that a request asks for; see `component`."""
        # A row with one good frame has matrices for all cameras, also for those whose frame never arrived.
        frames = set(self._facts) - set(self.recording.head.missing)
        run = self._board_type, self.result
        return choose_all(self._views, [self._part(ref)], run, (frames, self._facts), wanted, self._measured)[0]

    def center(self, ref: str) -> tuple[float, float]:
        """Return the centre of a component in CAD coordinates, in the unit of the board type."""
        require_text("center", "ref", ref)
        return self._part(ref).center

    def clamped(self, readings: Mapping[str, Sequence[float]], /, **options: Any) -> Clamped:
        """Return where the board lies that a tester has clamped; arguments as of `StationRun.clamped`.

        StateError: the run has no board type or no CAD mapping.
        """
        px_per_mm = float(np.mean([camera.px_per_mm for camera in self.cameras]))
        film = FilmedBoard(self._board_type, self.result, px_per_mm, self.status, self.reasons)
        return clamp(film, request_of(readings, options))

    def check_board_type(self, board_type: BoardType) -> CheckedBoardType:
        """Compare a board type with the pictures of this run, which may have been stitched with another one.

        Return shift, rotation, mirror and scale of its components, those that do not look as if they were there, and
        the corrected board type. InputError: it has too few components, or is larger than what was filmed.
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
            known = ", ".join(self.refs[:8])  # enough to show the form of an address
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
        return frame_facts(self.recording.head, self.flat_fields)

    def _measured(self, view: View) -> Measures:
        return measure(view, self._frame(view))

    def _frame(self, view: View) -> NDArray[Any]:
        frame = self.recording.frame(view.camera, view.row)
        assert frame is not None  # views of missing frames are left out
        return frame

    def load(self, choice: ChosenView) -> NDArray[Any]:
        """Read the frames of a chosen image, and render it."""
        other = None if choice.minus is None else self._frame(choice.minus.view)
        return render_chosen(choice, self._frame(choice.view), other)


def check_frame_index(camera: int, row: int, cameras: int, rows: int, name: str | Path) -> None:
    """Raise InputError with the limits if a run has no frame of this camera and row."""
    i, j = whole(camera), whole(row)
    if i is None or j is None or not (0 <= i < cameras and 0 <= j < rows):
        raise InputError(
            f"{name}: has no frame of camera {camera!r}, row {row!r}; cameras are 0 … {cameras - 1}, "
            f"rows 0 … {rows - 1}."
        )


def check_result(result: Stitch, rows: int, cameras: Sequence[Camera], name: str | Path) -> None:
    """Raise InputError if a result has other numbers of cameras or rows than a recording, or another calibration."""
    n, m = len(result.image_matrices), len(result.row_motion)
    difference = ""
    if (n, m) != (len(cameras), rows):
        difference = f"it has {n} cameras and {m} rows, the recording has {len(cameras)} cameras and {rows} rows"
    else:
        for i, camera in enumerate(_as_in_run(result, cameras)):
            first = result.image_matrices[i][0]
            # M_i0 equals N_i in every result (docs/conventions.md, gauge). So a difference means another calibration.
            if first is not None and _apart_px(first, camera) > _SAME_PX:
                difference = f"camera {i} has another calibration"
                break
    if difference:
        raise InputError(f"{name}: belongs to another recording: {difference}.", action="Stitch this recording again.")


def _as_in_run(result: Stitch, cameras: Sequence[Camera]) -> Sequence[Camera]:
    """Return the cameras with the displacements that the result states; as calibrated if it states none."""
    try:
        displacement_px = np.array(result.quality.get("camera_displacement_px"), dtype=np.float64)
    except (TypeError, ValueError):  # from a file, whose `quality` is not checked
        return cameras
    if displacement_px.shape != (len(cameras), PARAMETERS) or not np.isfinite(displacement_px).all():
        return cameras
    return displaced_cameras(cameras, displacement_px)


def _apart_px(matrix: Floats, camera: Camera) -> float:
    """Return the largest distance at the corners of a camera's frame between its N_i and a matrix, px."""
    w, h = camera.width_px - 1, camera.height_px - 1
    corners = np.array([(0, 0), (w, 0), (w, h), (0, h)], dtype=np.float64)
    image_from_image = np.asarray(matrix) @ np.linalg.inv(camera.image_from_row.matrix)
    return float(np.abs(apply(image_from_image, corners) - corners).max())
