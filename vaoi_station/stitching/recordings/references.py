"""A reference on disk: a directory with recording, calibration, board type and result, made by `vaoi teach`.

A reference of the station keeps a few frames per row (paper, section 3.3.3). All cameras of a row see the same motion
of the board, so a few frames determine it. Frames that are far apart determine its angle best.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from vaoi_station.errors import InputError
from vaoi_station.files import (
    Recording,
    open_recording,
    read_board_type,
    read_calibration,
    read_stitch,
    write_board_type,
    write_calibration,
    write_recording,
    write_stitch,
)
from vaoi_station.files.directories import new_directory, refuse_existing
from vaoi_station.files.images import Image
from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType, Calibration, RecordingHead, Status, Stitch
from vaoi_station.stitching.board.reference import Reference
from vaoi_station.stitching.expectation import expected_in, refuse_unplaceable
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.stitching.quality.quality_document import AMBIGUOUS
from vaoi_station.stitching.recordings.origin import cad_terms, with_origin
from vaoi_station.stitching.work import StitchSetup, stitch_frames

MOST_PER_ROW = 4
"""Largest number of frames that are kept per row."""
_LEAST_SHARE = 0.05
"""Least share of a frame that must show the board for the frame to be kept."""


def select_reference_frames(
    stitch: Stitch, cameras: Sequence[Camera], board_type: BoardType, present: Collection[FrameKey]
) -> frozenset[FrameKey]:
    """Select the frames that a reference keeps: at most `MOST_PER_ROW` of each row, spread evenly over the cameras."""
    c = stitch.cad_matrix
    assert c is not None, "only a run with a CAD mapping can be a reference"
    low, high = board_type.extent()
    board_mm = apply(c, np.array([low, (high[0], low[1]), high, (low[0], high[1])]))
    chosen: set[FrameKey] = set()
    for row, moved in enumerate(stitch.row_motion):
        place_mm = apply(moved, board_mm)
        showing = [i for i, camera in enumerate(cameras) if (i, row) in present and _shows(camera, place_mm)]
        # The first and the last camera are among them, because the angle is determined best over the longest distance.
        spread = np.linspace(0, len(showing) - 1, min(len(showing), MOST_PER_ROW)).round().astype(int)
        chosen |= {(showing[k], row) for k in spread}
    return frozenset(chosen)


def _shows(camera: Camera, board_mm: Floats) -> bool:
    """Return whether enough of a camera's frame shows the board with corners (4, 2)."""
    w, h = camera.width_px - 1.0, camera.height_px - 1.0
    view = camera.ground(np.array([[0, 0], [w, 0], [w, h], [0, h]])).astype(np.float32)
    area, _ = cv2.intersectConvexConvex(view, board_mm.astype(np.float32))
    return float(area) >= _LEAST_SHARE * abs(cv2.contourArea(view))


RESULT = "result.json"
CONFIRM = (
    "If the board lies as its board type says, confirm it once: `vaoi teach --confirm-orientation`, or "
    "`confirm_orientation` of the REST request. Otherwise turn the board and film it again."
)
"""Action for a run whose only fault is its ambiguous orientation."""
_SAME_CALIBRATION_PX = 0.05
"""Largest accepted difference between the calibrations of reference and run, px: it adds to the error of positions."""


@dataclass(frozen=True, eq=False)
class StoredReference:
    """A reference, together with the recording that holds its frames."""

    reference: Reference
    recording: Recording


def teach(
    case: Path,
    calibration: Path,
    board: Path,
    out: Path,
    *,
    confirm_orientation: bool = False,
    rotation_deg: int | None = None,
) -> Stitch:
    """Stitch a recording and store it as a reference in the new directory `out`.

    `confirm_orientation` states that a person saw the board lie as the board type expects it. The reference keeps
    `rotation_deg`, by default that of the recording. Raises `InputError` if the directory exists, or if the result is
    not good enough to be a reference.
    """
    refuse_existing(out)  # This check comes before stitching, which takes seconds.
    recording = open_recording(case).with_rotation(rotation_deg)
    known, board_type = read_calibration(calibration, recording.head.cameras), read_board_type(board)
    refuse_unplaceable(board_type, board)
    setup = _setup(recording, known.cameras(recording.head.cameras), board_type)
    stitch = with_origin(stitch_frames(setup, recording.head, recording.frame), recording, known, board_type)
    if confirm_orientation:
        stitch = with_confirmed_orientation(stitch)
    if stitch.status is not Status.OK:
        reasons = "; ".join(stitch.reasons)
        action = CONFIRM if awaits_confirmation(stitch) else "Film it again."
        raise InputError(f"{case}: is {stitch.status} and cannot be a reference: {reasons}.", action=action)
    with new_directory(out) as draft:
        # The truth of a simulated recording is not copied, since no part of the product may read it.
        shutil.copytree(case, draft, ignore=shutil.ignore_patterns("truth.json"), dirs_exist_ok=True)
        recording.copy_head(draft)
        shutil.copyfile(calibration, draft / "calibration.json")
        shutil.copyfile(board, draft / "board.json")
        write_stitch(draft / RESULT, stitch)
    return stitch


def awaits_confirmation(stitch: Stitch) -> bool:
    """Return whether a result is not ok only because the board turned by 180° would fit as well."""
    # The ambiguous orientation is a reason too: if there is only one reason, it is this one.
    ambiguous = stitch.quality.get("orientation") == AMBIGUOUS
    return ambiguous and stitch.status is Status.DEGRADED and len(stitch.reasons) == 1


def with_confirmed_orientation(stitch: Stitch) -> Stitch:
    """Return a result without its only reason, the ambiguous orientation, which a person has confirmed.

    A result with other reasons, or with none, is returned unchanged.
    """
    if not awaits_confirmation(stitch):
        return stitch
    quality = stitch.quality | {"orientation": "confirmed"}
    return stitch.model_copy(update={"status": Status.OK, "reasons": (), "reason_codes": (), "quality": quality})


def write_reference(
    directory: Path,
    head: RecordingHead,
    frames: Iterable[tuple[int, int, Image]],
    calibration: Calibration,
    board_type: BoardType,
    stitch: Stitch,
) -> None:
    """Write a stitched run as a reference, of which `head` lists frames that are not kept as missing.

    The directory appears complete or not at all.
    """
    with new_directory(directory) as draft:
        write_calibration(draft / "calibration.json", calibration)
        write_board_type(draft / "board.json", board_type)
        write_stitch(draft / RESULT, stitch)
        write_recording(draft, head, frames, suffix=".tiff")


def open_reference(directory: Path, cameras: tuple[Camera, ...], board_type: BoardType) -> StoredReference:
    """Open a reference for runs of these cameras and this board type; stitch the reference if it has no result yet.

    Raises `InputError` if the reference was filmed with another calibration, or shows another board type.
    """
    recording = open_recording(directory)
    theirs = read_calibration(directory / "calibration.json", recording.head.cameras).cameras(recording.head.cameras)
    _check_calibration(directory, theirs, cameras)
    own = read_board_type(directory / "board.json")
    _check_board_type(directory, own, board_type)
    if (directory / RESULT).is_file():
        stitch = read_stitch(directory / RESULT)
    else:
        stitch = stitch_frames(_setup(recording, theirs, own), recording.head, recording.frame)
    if stitch.cad_matrix is None or stitch.status is not Status.OK:
        raise InputError(
            f"{directory}: is {stitch.status} and cannot be a reference: {'; '.join(stitch.reasons)}.",
            action=CONFIRM if awaits_confirmation(stitch) else "Film the board again, and teach it with `vaoi teach`.",
            code="not-a-reference",
        )
    sigma_px = stitch.quality.get("cad_sigma_px")
    if sigma_px is None:
        raise InputError(
            f"{directory}/{RESULT}: quality.cad_sigma_px is absent, but the error of the reference must be known.",
            action="Teach the reference again with `vaoi teach`.",
        )
    lost = set(recording.head.missing)
    everything = {(i, j) for i in range(len(theirs)) for j in range(recording.head.rows)}
    # Only the fields that linking needs are kept, since this object is sent to every worker with every run.
    used = stitch.model_copy(update={"image_matrices": (), "components": None, "quality": {}})
    reference = Reference(used, frozenset(everything - lost), _name(recording.head, used), float(sigma_px))
    return StoredReference(reference, recording)


def _setup(recording: Recording, cameras: tuple[Camera, ...], board_type: BoardType) -> StitchSetup:
    head, expected = recording.head, expected_in(recording.head)
    conveyor = head.conveyor_mm_s, head.trigger_period_s
    return StitchSetup(cameras, *conveyor, board_type, expected, lights=head.lights or ())


def _name(head: RecordingHead, stitch: Stitch) -> str:
    """Return the name of a reference: the run's id if the recording has one, else a hash of the result's matrices."""
    # The name is not a path, which would change when the directory is copied, and with it the name in later results.
    if isinstance(run := (head.model_extra or {}).get("x_run"), str):
        return run
    matrices = b"".join(m.tobytes() for m in (stitch.cad_matrix, *stitch.row_motion) if m is not None)
    return hashlib.sha256(matrices).hexdigest()[:16]


def _check_board_type(directory: Path, theirs: BoardType, ours: BoardType) -> None:
    if [c.address for c in theirs.components] != [c.address for c in ours.components]:
        raise InputError(
            f"{directory}: shows board type {theirs.name!r}, whose components are not those of {ours.name!r}.",
            action="Teach a reference of this board type.",
        )
    # Components may change freely as long as their addresses stay; C depends on these keys only.
    before, now = cad_terms(theirs), cad_terms(ours)
    changed = sorted(key for key in now if before[key] != now[key])
    if changed:
        raise InputError(
            f"{directory}: was taught when the board type {ours.name!r} had other {', '.join(changed)}.",
            action="Teach a reference of the board type as it is now.",
        )


def _check_calibration(directory: Path, theirs: tuple[Camera, ...], ours: tuple[Camera, ...]) -> None:
    if len(theirs) != len(ours):
        raise InputError(f"{directory}: was filmed by {len(theirs)} cameras, this run by {len(ours)}.")
    for i, (a, b) in enumerate(zip(theirs, ours, strict=True)):
        corners = np.array([[0, 0], [b.width_px, 0], [b.width_px, b.height_px], [0, b.height_px]], dtype=np.float64)
        off = float(np.abs(a.project(b.ground(corners)) - corners).max())
        if (a.width_px, a.height_px) != (b.width_px, b.height_px) or off > _SAME_CALIBRATION_PX:
            raise InputError(
                f"{directory}: was filmed with another calibration: camera {i} differs by {off:.2f} px "
                f"(limit {_SAME_CALIBRATION_PX}).",
                action="Teach the reference again with the present calibration.",
            )
