"""A recording on disk, with its calibration and board type."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.files import read_stitch
from vaoi_station.library.arguments import require_path
from vaoi_station.library.stitched_run import StitchedRun, check_frame_index, check_result
from vaoi_station.model import BoardType, Calibration, Stitch
from vaoi_station.stitching.matching.evidence import MethodName
from vaoi_station.stitching.paper_method import stitch_by_paper
from vaoi_station.stitching.recordings.opening import OpenedRun, open_run
from vaoi_station.stitching.recordings.origin import check_origin, with_origin
from vaoi_station.stitching.work import stitch_frames

Method = Literal["auto", "features", "fiducials", "reference", "paper"]
METHODS: tuple[Method, ...] = ("auto", "features", "fiducials", "reference", "paper")


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
        """Stitch the recording; see `docs/measured/methods.md` for the methods.

        Raises:
            InputError: the method is unknown, or needs a reference that was not given.
        """
        if not isinstance(method, str) or method not in METHODS:
            raise InputError(f"method is {method!r}, but must be one of {', '.join(METHODS)}.")
        # The paper's method is not a kind of evidence. It replaces the station's stitching below and ignores this
        # setting.
        evidence: MethodName = "auto" if method == "paper" else method
        # The run is opened for each call, because the kind of evidence is part of the set-up that an opened run holds.
        opened = open_run(
            self.directory,
            calibration=self.calibration_path,
            board=self.board_path,
            reference=self.reference_path,
            method=evidence,
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
        """Combine the recording with a result, or with a result file of an earlier stitch.

        Raises:
            InputError: the result belongs to another recording, calibration or board type. This is checked by pixels
                of a frame and by the documents, if the result was made by `stitch` or `vaoi stitch`; results of other
                sources and of older versions are compared by calibration and numbers of cameras and rows only.
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
