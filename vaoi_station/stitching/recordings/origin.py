"""The origin of a result: from which recording, calibration and CAD data it was made.

By its shape alone, a result fits every recording of the same array with the same number of rows. Its origin shows
whether it belongs to a given recording. The origin is stored in `quality`, in which older versions accept any keys.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.files import Recording
from vaoi_station.files.documents import parse
from vaoi_station.model import BoardType, Calibration, Stitch, Strict, Whole
from vaoi_station.model.board_type import OF_IMPORT

KEY = "recording"
"""Key under which the origin is stored in `quality`."""
ESTIMATED_BITS = "estimated_bits"
"""Key of `quality` for `Recording.estimated_bits`."""
CAD_TERMS = frozenset({"unit", "y_axis", "side", "fiducials"})
"""Keys of a board type on which C depends. Other keys, such as the components, may change between stitching and
cutting."""
_OPTICS = frozenset({"camera_matrices", "working_distance_mm", "principal_point", "distortion"})
"""Keys of a calibration on which the positions in frames depend."""


class Origin(Strict):
    """The origin of a result: names, which people read, and digests, by which two origins are compared."""

    name: str
    """Id of the run if the recording has one, otherwise the name of its directory."""
    frame: tuple[Whole, Whole] | None
    """Camera and row of the frame that identifies the recording; None if no frame arrived."""
    pixels: str | None
    """Digest of the pixels of the frame that identifies the recording."""
    calibration: str
    board_type: str | None
    """Name of the board type; None without one."""
    cad_data: str | None


def with_origin(result: Stitch, recording: Recording, calibration: Calibration, board_type: BoardType | None) -> Stitch:
    """Return the result with its origin added, and with the scale of its grey levels if that had to be estimated."""
    origin = _origin(recording, calibration, board_type, _typical_frame(recording))
    bits = recording.estimated_bits
    scale = {} if bits is None else {ESTIMATED_BITS: bits}
    return result.model_copy(update={"quality": {**result.quality, KEY: origin.model_dump(mode="json"), **scale}})


def check_origin(
    result: Stitch, recording: Recording, calibration: Calibration, board_type: BoardType | None, name: str | Path
) -> None:
    """Raise `InputError` for a result, if it has an origin, of another recording, calibration or CAD data."""
    if KEY not in result.quality:
        return
    there = parse(Origin, result.quality[KEY], f"{name}: quality.{KEY}")
    here = _origin(recording, calibration, board_type, there.frame)
    ours = f"the one given is {here.name!r} ({recording.directory})"
    if there.pixels != here.pixels:
        difference = f"it was made from recording {there.name!r}, {ours}, and their frame {there.frame} differs"
    elif there.calibration != here.calibration:
        difference = f"it was made from recording {there.name!r} with another calibration; {ours}"
    # Without a board type, the matrices of the frames can still be used.
    elif None not in (there.cad_data, here.cad_data) and there.cad_data != here.cad_data:
        terms = ", ".join(sorted(CAD_TERMS))
        difference = (
            f"it was made with board type {there.board_type!r}, and the one given, {here.board_type!r}, differs in one "
            f"of {terms}"
        )
    else:
        return
    raise InputError(
        f"{name}: belongs to another recording: {difference}.",
        action="Give the result of this recording, or stitch it again.",
    )


def cad_terms(board_type: BoardType) -> dict[str, Any]:
    """Return the values on which C depends, by the names of their keys."""
    return board_type.model_dump(include=set(CAD_TERMS), exclude=OF_IMPORT)


def cad_digest(board_type: BoardType) -> str:
    """Return the digest of the values on which C depends; newer optional keys do not change it."""
    return _digest(board_type.model_dump_json(include=set(CAD_TERMS), exclude=OF_IMPORT) + board_type.local_terms)


def _origin(
    recording: Recording, calibration: Calibration, board_type: BoardType | None, frame: tuple[int, int] | None
) -> Origin:
    return Origin(
        name=_name(recording),
        frame=frame,
        pixels=_pixel_digest(recording, frame),
        calibration=_digest(calibration.model_dump_json(include=set(_OPTICS))),
        board_type=None if board_type is None else board_type.name,
        cad_data=None if board_type is None else cad_digest(board_type),
    )


def _name(recording: Recording) -> str:
    run = (recording.head.model_extra or {}).get("x_run")
    return run if isinstance(run, str) and run else recording.directory.resolve().name


def _typical_frame(recording: Recording) -> tuple[int, int] | None:
    """Return camera and row of the frame nearest to the middle of the run: it shows the board, not the empty belt."""
    # One frame suffices: sensor noise makes the frames of any two boards different. Decoding it takes some 10 ms;
    # decoding all frames would take as long as stitching. Pixels are compared, not files: a recording may be stored as
    # PNG or TIFF.
    head = recording.head
    lost, middle = set(head.missing), (head.rows - 1) / 2
    keys = ((abs(j - middle), j, i) for i in range(len(head.cameras)) for j in range(head.rows) if (i, j) not in lost)
    found = min(keys, default=None)
    return None if found is None else (found[2], found[1])


def _pixel_digest(recording: Recording, frame: tuple[int, int] | None) -> str | None:
    """Compute the digest of a frame's pixels; None if the recording has no such frame."""
    head = recording.head
    if frame is None or not (0 <= frame[0] < len(head.cameras) and 0 <= frame[1] < head.rows):
        return None
    pixels: NDArray[Any] | None = recording.frame(*frame)
    if pixels is None:
        return None
    return _digest(f"{pixels.dtype.str} {pixels.shape} ".encode() + np.ascontiguousarray(pixels).tobytes())


def _digest(content: str | bytes) -> str:
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()[:16]
