"""Sentences with codes: reasons of states and verdicts, and notes on what a person should check."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from vaoi_station.errors import VaoiError
from vaoi_station.model.frozen_model import Strict


class ReasonCode(StrEnum):
    """Code of a reason of a result, the same in every version. `codes.toml` has meaning and action of each.

    What else a new one needs: `docs/CONTRIBUTING.md`, "A reason of a verdict, with its code".
    """

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
    CAMERA_NOT_CALIBRATED = "camera-not-calibrated"
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


class Reason(Strict):
    """Explanation of a state or verdict, with the action that the user can take."""

    code: str
    message: str
    action: str = ""
    cause: str = ""
    """For a reason of a run's result, its code in `reason_codes` of the matrices; otherwise empty."""

    def __init__(self, code: str, message: str, action: str = "", cause: str = "", **unknown: Any) -> None:
        """Create it; code and message may be given by position."""
        super().__init__(**{"code": str(code), "message": message, "action": action, "cause": cause, **unknown})

    @staticmethod
    def of(error: VaoiError) -> Reason:
        """Return a reason with the code, message and action of an error."""
        return Reason(error.code, error.message, error.action)


class Note(str):
    """A sentence on what a person should check, as text; programs and translations go by its code and its values.

    Attributes:
        code: what it says (codes.toml).
        values: what the sentence states, such as numbers and designators, as they are written in it.
    """

    __slots__ = ("code", "values")
    code: str
    values: Mapping[str, str]

    def __new__(cls, code: str, sentence: str, **values: object) -> Note:
        """Create it; `values` are written as in the sentence."""
        note = super().__new__(cls, sentence)
        note.code, note.values = code, {name: str(value) for name, value in values.items()}
        return note

    def __getnewargs_ex__(self) -> tuple[tuple[str, str], dict[str, str]]:
        """Return the arguments of a copy, for `copy` and `pickle`."""
        return (self.code, str(self)), dict(self.values)
