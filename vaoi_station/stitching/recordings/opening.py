"""Opening of a recording on disk for stitching, with its calibration, board type and reference, if any."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from vaoi_station.errors import InputError
from vaoi_station.files import Recording, open_recording, read_board_type, read_calibration
from vaoi_station.model import Calibration
from vaoi_station.stitching.expectation import StitchTerms, expected_in, refuse_unplaceable
from vaoi_station.stitching.matching.evidence import FrameKey, MethodName
from vaoi_station.stitching.recordings.references import StoredReference, open_reference
from vaoi_station.stitching.work import Frames, StitchSetup, TaskRunner


@dataclass(frozen=True, eq=False)
class OpenedRun:
    """All inputs for the stitching of a recorded run, with the paths from which they were read."""

    recording: Recording
    calibration: Calibration
    calibration_path: Path
    board_path: Path | None
    """File of the board type; None if the board type is unknown."""
    reference: StoredReference | None
    setup: StitchSetup

    @property
    def present(self) -> tuple[FrameKey, ...]:
        """Keys (camera, row) of the frames that arrived, ordered by camera, then by row."""
        head = self.recording.head
        lost = set(head.missing)
        keys = ((i, j) for i in range(len(head.cameras)) for j in range(head.rows))
        return tuple(key for key in keys if key not in lost)

    def runner(self, frame: Frames | None = None) -> TaskRunner:
        """Make a task runner for the run. It reads frames with the function `frame`, by default from disk."""
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
    rotation_deg: int | None = None,
    terms: StitchTerms | None = None,
) -> OpenedRun:
    """Open a recording for stitching, with the calibration, board type and rotation in it unless others are given.

    `reference` is the directory of one, and `terms` what the station knew of line and lights: by default only the
    expected rotation is known. Raises `InputError` if the inputs do not fit together, if the board type has too few
    fiducials to be placed, or if a reference is given without a board type.
    """
    recording = open_recording(case).with_rotation(rotation_deg)
    head = recording.head
    calibration_path = calibration or case / "calibration.json"
    known = read_calibration(calibration_path, head.cameras)
    # Arguments take precedence over files of the recording, so that a correction is tried without changing these files.
    own = case / "board.json"
    board_path = board or (own if own.is_file() else None)
    board_type = read_board_type(board_path) if board_path else None
    if board_type is not None and board_path is not None:
        refuse_unplaceable(board_type, board_path)
    setup = StitchSetup(
        cameras=known.cameras(head.cameras),
        conveyor_mm_s=head.conveyor_mm_s,
        trigger_period_s=head.trigger_period_s,
        board_type=board_type,
        expectation=expected_in(head),
        method=method,
        lights=head.lights or (),
    )
    if terms is not None and board_type is not None:
        expected = replace(terms.expectation(board_type), skipped=setup.expectation.skipped)
        setup = replace(setup, expectation=expected, visibility=terms.visibility, channels=terms.channels)
    stored = _open_reference(reference, setup)
    if stored is not None:
        setup = replace(setup, reference=stored.reference)
    return OpenedRun(recording, known, calibration_path, board_path, stored, setup)


def _open_reference(directory: Path | None, setup: StitchSetup) -> StoredReference | None:
    if directory is None:
        if setup.method == "reference":
            raise InputError(
                "the method 'reference' needs a reference, and none is given.",
                action="Give the directory of one (--reference DIR, or the argument reference); `vaoi teach` makes it.",
            )
        return None
    if setup.board_type is None:
        raise InputError(
            f"{directory}: a reference needs the board type of the run, and the recording has none.",
            action="Give the board type (--board FILE, or the argument board_type).",
        )
    return open_reference(directory, setup.cameras, setup.board_type)
