"""A recording on disk, opened for stitching: with its calibration, board type and perhaps a reference."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from vaoi_station.errors import InputError
from vaoi_station.files import Recording, open_recording, read_board_type, read_calibration
from vaoi_station.model import Calibration
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.stitching.method import MethodName
from vaoi_station.stitching.recordings.offline import Frames
from vaoi_station.stitching.recordings.reference_directory import StoredReference, open_reference, with_reference
from vaoi_station.stitching.work import StitchSetup, TaskRunner


@dataclass(frozen=True, eq=False)
class OpenedRun:
    """All inputs of the stitching of a recorded run, with the paths they were read from."""

    recording: Recording
    calibration: Calibration
    calibration_path: Path
    board_path: Path | None
    """None where no board type is known."""
    reference: StoredReference | None
    setup: StitchSetup

    @property
    def present(self) -> tuple[FrameKey, ...]:
        """The frames that arrived, by camera, then row."""
        head = self.recording.head
        lost = set(head.missing)
        keys = ((i, j) for i in range(len(head.cameras)) for j in range(head.rows))
        return tuple(key for key in keys if key not in lost)

    def runner(self, frame: Frames | None = None) -> TaskRunner:
        """Make a task runner that reads the frames of the run by `frame`, by default from disk."""
        return TaskRunner(
            self.setup, frame or self.recording.frame, self.reference.recording.frame if self.reference else None
        )


def open_run(
    case: Path,
    *,
    calibration: Path | None = None,
    board: Path | None = None,
    reference: Path | None = None,
    method: MethodName = "auto",
) -> OpenedRun:
    """Open a recording for stitching.

    Args:
        case: directory of the recording.
        calibration: by default the recording's own.
        board: board type; by default the recording's own, if it has one.
        reference: directory made by `vaoi teach`.
        method: names the evidence to use.

    Raises:
        InputError: the inputs do not fit together: number of cameras, a reference without a board type.
    """
    recording = open_recording(case)
    head = recording.head
    calibration_path = calibration or case / "calibration.json"
    known = read_calibration(calibration_path, head.cameras)
    # Arguments come before the files of the recording: a correction is tried without changing the recording.
    own = case / "board.json"
    board_path = board or (own if own.is_file() else None)
    setup = StitchSetup(
        cameras=known.cameras(head.cameras),
        conveyor_mm_s=head.conveyor_mm_s,
        trigger_period_s=head.trigger_period_s,
        board_type=read_board_type(board_path) if board_path else None,
        method=method,
    )
    stored = _open_reference(reference, setup)
    return OpenedRun(recording, known, calibration_path, board_path, stored, with_reference(setup, stored))


def _open_reference(directory: Path | None, setup: StitchSetup) -> StoredReference | None:
    if directory is None:
        if setup.method == "reference":
            raise InputError("--method reference needs --reference DIR.", action="`vaoi teach` makes one.")
        return None
    if setup.board_type is None:
        raise InputError("--reference needs a board type.", action="Give one with --board.")
    return open_reference(directory, setup.cameras, setup.board_type)
