"""The reasons of a verdict: why a result is not `ok`, as a stable code for programs and a sentence for people."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple


class ReasonCode(StrEnum):
    """The code of a reason, the same in every version. `docs/formats.md` states its meaning and the action for each."""

    NO_FRAMES = "no-frames"
    CAMERA_ABSENT = "camera-absent"
    TRIGGER_DOUBTFUL = "trigger-doubtful"
    NO_TEXTURE = "no-texture"
    LIGHT_DARK = "light-dark"
    ROWS_LOST = "rows-lost"
    ROWS_NOT_CONNECTED = "rows-not-connected"
    ROWS_REPETITIVE = "rows-repetitive"
    LINKS_SCATTER = "links-scatter"
    WRONG_ROWS = "wrong-rows"
    CAMERA_DISPLACED = "camera-displaced"
    PICTURES_BLURRED = "pictures-blurred"
    LENS_DIFFERS = "lens-differs"
    OVERLAP_BLANK = "overlap-blank"
    OVERLAP_EXPOSURE = "overlap-exposure"
    OVERLAP_REPETITIVE = "overlap-repetitive"
    BOARD_OFF_PLANE = "board-off-plane"
    NOT_EXPLAINED = "not-explained"
    NO_BOARD_TYPE = "no-board-type"
    TOO_FEW_FIDUCIALS = "too-few-fiducials"
    FIDUCIALS_NOT_FOUND = "fiducials-not-found"
    FIDUCIAL_SIZE = "fiducial-size"
    FIDUCIAL_MISSING = "fiducial-missing"
    FIDUCIAL_OFF_PLACE = "fiducial-off-place"
    FIDUCIAL_WRONG = "fiducial-wrong"
    LOCAL_FIDUCIAL_UNUSABLE = "local-fiducial-unusable"
    BOARD_UNPLACED = "board-unplaced"
    BAD_BOARD_DOUBTFUL = "bad-board-doubtful"
    SCALE_WRONG = "scale-wrong"
    SURFACE_UNLIKELY = "surface-unlikely"
    OUTLINE_SHIFTED = "outline-shifted"
    OUTLINE_TURNED = "outline-turned"
    OUTLINE_INVISIBLE = "outline-invisible"
    COMPONENTS_SHIFTED = "components-shifted"
    UNLISTED_PARTS = "unlisted-parts"
    BOARD_TURNED = "board-turned"
    ORIENTATION_AMBIGUOUS = "orientation-ambiguous"
    REFERENCE_NOT_FOUND = "reference-not-found"
    REFERENCE_CONTRADICTS = "reference-contradicts"
    TEXTURE_OFF_BOARD = "texture-off-board"
    POSITIONS_UNCERTAIN = "positions-uncertain"
    COMPONENTS_UNSEEN = "components-unseen"
    FRAMES_UNCONFIRMED = "frames-unconfirmed"
    ROWS_NOT_CHAINED = "rows-not-chained"
    NO_ERROR_MEASURE = "no-error-measure"


class Reason(NamedTuple):
    """One reason of a verdict."""

    code: ReasonCode
    text: str
    """A sentence with names, values and limits, and with the action to take."""
