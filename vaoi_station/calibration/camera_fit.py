"""One camera: from the marks it sees to its N_i and lens, or to the reason why not."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vaoi_station.calibration.homography_fit import Fit, estimate_homography, fit_camera
from vaoi_station.calibration.mark_detection import DetectedMarks, MarkAppearance, least_score, locate_cross
from vaoi_station.calibration.mark_identification import Hypothesis
from vaoi_station.calibration.nominal_view import is_in_frame, nominal_matrix
from vaoi_station.calibration.outlier_removal import remove_outliers
from vaoi_station.calibration.plausibility import find_implausibility
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import CameraHead

LEAST_MARKS = 4
BLUR_LIMIT_PX = 2.0
_LEAST_CONTRAST = 20.0
_LEAST_SIZE_PX = 8
_LEAST_SHARE = 0.3
"""Of the marks that the layout puts into the frame, so many must be there, or it is the layout of another board."""


@dataclass(frozen=True, eq=False)
class MarkObservation:
    """A mark of the layout that belongs into the frame: where it is, or why it was not used."""

    index: int
    """In the layout."""
    expected_px: Floats
    px: Floats | None = None
    residual_px: Floats | None = None
    note: str = ""

    @property
    def used(self) -> bool:
        """Whether N_i rests on it."""
        return self.residual_px is not None


@dataclass(frozen=True, eq=False)
class CameraResult:
    """What became of one camera."""

    camera: int
    head: CameraHead
    detected: DetectedMarks
    marks: tuple[MarkObservation, ...] = ()
    fit: Fit | None = None
    refusal: str = ""
    """Why there is no N_i, with number and limit."""
    action: str = ""
    """What to do about it."""
    notes: tuple[str, ...] = ()

    @property
    def used(self) -> int:
        """Marks that N_i rests on."""
        return sum(m.used for m in self.marks)

    @property
    def corner_sigma_px(self) -> float:
        """How far a point in the worst corner of the frame may be off, one sigma; NaN without a fit."""
        if self.fit is None:
            return math.nan
        w, h = self.head.width - 1.0, self.head.height - 1.0
        return float(self.fit.sigma_at_px(np.array([[0, 0], [w, 0], [0, h], [w, h]])).max())


@dataclass(frozen=True)
class Limits:
    """What a calibration must keep to."""

    residual_px: float = 0.2
    """Root mean square residual of one camera."""
    working_distance_mm: float | None = None


def calibrate_camera(
    camera: int,
    head: CameraHead,
    seen: DetectedMarks,
    option: Hypothesis | None,
    marks_mm: Floats,
    kind: MarkAppearance,
    to: Limits,
) -> CameraResult:
    """Calibrate one camera.

    Args:
        camera: its number.
        head: its frame and nominal view.
        seen: the marks in its frame.
        option: which of them are which.
        marks_mm: (k, 2) of the whole layout.
        kind: how marks look in this frame.
        to: the limits.
    """
    due = _expected(head, camera, seen, option, marks_mm, kind)
    if (unfit := _unfit_size(kind, head) or _unfit_picture(seen, option, due)) is not None:
        return CameraResult(camera, head, seen, due, None, *unfit)
    assert option is not None
    pairs = option.pairs
    place = estimate_homography(seen.px[pairs[:, 1]], marks_mm[pairs[:, 0]])
    marks = _looked_up(place if place is not None else option.similarity, head, seen, option, marks_mm, kind)
    index, px = _measured(marks)
    fit = fit_camera(marks_mm[index], px, _center(head), math.hypot(head.width, head.height) / 2)
    if isinstance(fit, Failure):
        action = "Use marks that span the frame in both directions; uncover those that are not seen."
        return CameraResult(camera, head, seen, marks, None, fit.reason, action)
    fit, kept = remove_outliers(fit, marks_mm[index], px)
    marks = _with_residuals(marks, index, kept, fit)
    result = CameraResult(camera, head, seen, marks, fit, notes=_notes(marks, seen, fit))
    refusal, action = _unfit_result(result, option, to)
    return CameraResult(camera, head, seen, marks, fit, refusal, action, result.notes)


def _unfit_size(kind: MarkAppearance, head: CameraHead) -> tuple[str, str] | None:
    """Why marks of this size cannot be measured, and what to do."""
    most = min(head.width, head.height) / 2
    if _LEAST_SIZE_PX <= kind.size_px <= most:
        return None
    return (
        f"the layout's marks would be {kind.size_px:.0f} px large in its frame, but must be {_LEAST_SIZE_PX} … "
        f"{most:.0f} px",
        "Correct unit and mark.size in layout.json, or nominal_px_per_mm.",
    )


def _unfit_picture(
    seen: DetectedMarks, option: Hypothesis | None, due: tuple[MarkObservation, ...]
) -> tuple[str, str] | None:
    """Why the picture yields no marks to work with, and what to do."""
    known = 0 if option is None else len(option.pairs)
    if seen.contrast < _LEAST_CONTRAST:
        return (
            f"its picture has a contrast of {seen.contrast:.0f} grey levels, at least {_LEAST_CONTRAST:.0f} are needed",
            "Check light, exposure, lens cap, and that the board lies in its view.",
        )
    if known < LEAST_MARKS and seen.opposite > len(seen.px):
        return (
            f"it shows {seen.opposite} marks of the opposite brightness and {len(seen.px)} of the layout's polarity",
            "Correct mark.polarity in layout.json.",
        )
    if seen.blur_px > BLUR_LIMIT_PX and not len(seen.px):
        return (
            f"it shows no mark, and its steepest edges are blurred by {seen.blur_px:.1f} px (sigma), "
            f"the limit is {BLUR_LIMIT_PX:.1f} px",
            "Focus the lens, and check that the board lies uncovered in its view.",
        )
    if seen.blur_px > BLUR_LIMIT_PX:
        return (
            f"its picture is blurred by {seen.blur_px:.1f} px (sigma), the limit is {BLUR_LIMIT_PX:.1f} px",
            "Focus the lens, and film the board at rest or with a short exposure.",
        )
    if known >= LEAST_MARKS:
        return None
    return (
        f"it shows {len(seen.px)} marks, of which {known} fit the layout; at least {LEAST_MARKS} are needed"
        + _absent(due, option),
        "Move the board until every camera sees four marks, uncover them, and check that layout.json belongs to this "
        "board and nominal_center_mm to this camera.",
    )


def _absent(due: tuple[MarkObservation, ...], option: Hypothesis | None) -> str:
    """Where marks of the layout should be seen whole and are not; nothing where that is not known."""
    places = [m.expected_px for m in due if m.px is None] if option is not None else []
    told = ", ".join(f"({x:.0f}, {y:.0f})" for x, y in places[:LEAST_MARKS])
    more = f" and {len(places) - LEAST_MARKS} places more" if len(places) > LEAST_MARKS else ""
    return f"; no whole mark is seen at {told} px{more}, where the layout has one" if places else ""


def _unfit_result(result: CameraResult, option: Hypothesis, to: Limits) -> tuple[str, str]:
    """Why a fit is not to be trusted, and what to do; two empty texts if it is."""
    fit = result.fit
    assert fit is not None
    wrong = "Check that layout.json belongs to this board, its unit, and that it is written as cameras see the board."
    if result.used < _LEAST_SHARE * len(result.marks):
        return (
            f"it shows {result.used} of the {len(result.marks)} marks that the layout puts into its frame, "
            f"at least {math.ceil(_LEAST_SHARE * len(result.marks))} are needed",
            wrong,
        )
    strangers = len(result.detected.px) - len(option.pairs)
    if strangers > result.used:
        return f"it shows {strangers} marks that are not in the layout, more than the {result.used} that are", wrong
    if fit.rms_px > to.residual_px:
        return (
            f"its residuals are {fit.rms_px:.2f} px (rms, {result.used} marks), the limit is {to.residual_px:.2f} px",
            wrong + " A print can be off too: see the picture.",
        )
    why = find_implausibility(fit.matrix, result.head, to.working_distance_mm)
    return ("", "") if why is None else (why, wrong)


def _expected(
    head: CameraHead,
    camera: int,
    seen: DetectedMarks,
    option: Hypothesis | None,
    marks_mm: Floats,
    kind: MarkAppearance,
) -> tuple[MarkObservation, ...]:
    """Where marks would be by what is known, and where those are that are known, for the picture of a refusal."""
    px = apply(option.similarity if option else nominal_matrix(head, camera), marks_mm)
    known = {int(k): seen.px[n] for k, n in option.pairs} if option else {}
    due = sorted({*np.flatnonzero(is_in_frame(head, px, kind.margin_px)).tolist(), *known})
    return tuple(MarkObservation(k, px[k], known.get(k)) for k in due)


def _looked_up(
    matrix: Floats, head: CameraHead, seen: DetectedMarks, option: Hypothesis, marks_mm: Floats, kind: MarkAppearance
) -> tuple[MarkObservation, ...]:
    """Every mark that belongs into the frame: as seen, or looked for where it must be."""
    expected, known = apply(matrix, marks_mm), {int(k): int(n) for k, n in option.pairs}
    least = least_score(seen.score)
    marks = []
    due = np.flatnonzero(is_in_frame(head, expected, kind.margin_px))
    for k in sorted({*due.tolist(), *known}):
        if k in known:
            marks.append(MarkObservation(k, expected[k], seen.px[known[k]]))
            continue
        mark = locate_cross(seen.grey, expected[k], kind)
        if isinstance(mark, Failure):
            marks.append(MarkObservation(k, expected[k], note=f"not seen ({mark.reason})"))
        elif mark.light != kind.light or mark.score < least:
            marks.append(MarkObservation(k, expected[k], note=f"unlike the others (correlation {mark.score:.2f})"))
        elif np.hypot(*(mark.px - expected[k])) > 0.25 * kind.size_px:
            marks.append(MarkObservation(k, expected[k], note="not where it must be"))
        else:
            marks.append(MarkObservation(k, expected[k], mark.px))
    return tuple(marks)


def _measured(marks: tuple[MarkObservation, ...]) -> tuple[list[int], Floats]:
    return [m.index for m in marks if m.px is not None], np.array([m.px for m in marks if m.px is not None])


def _with_residuals(
    marks: tuple[MarkObservation, ...], index: list[int], kept: list[int], fit: Fit
) -> tuple[MarkObservation, ...]:
    residual = {index[k]: fit.residuals_px[n] for n, k in enumerate(kept)}
    out = []
    for m in marks:
        if m.px is None:
            out.append(m)
        elif m.index in residual:
            expected = m.px - residual[m.index]
            out.append(MarkObservation(m.index, expected, m.px, residual[m.index]))
        else:
            out.append(MarkObservation(m.index, m.expected_px, m.px, None, "at odds with the others"))
    return tuple(out)


def _notes(marks: tuple[MarkObservation, ...], seen: DetectedMarks, fit: Fit) -> tuple[str, ...]:
    """What the operator should know though the camera is calibrated."""
    notes = [
        f"the mark that belongs at ({m.expected_px[0]:.0f}, {m.expected_px[1]:.0f}) px is {m.note}; not used"
        for m in marks
        if not m.used
    ]
    notes += [
        f"the mark at ({x:.0f}, {y:.0f}) px {why}; not used"
        for (x, y), why in seen.doubtful
        if all(m.used or np.hypot(*(m.expected_px - (x, y))) > 10 for m in marks)
    ]
    if fit.freedom == 0:
        notes.append("four marks fix N and leave nothing over to check it by: its residuals are always 0")
    return tuple(notes)


def _center(head: CameraHead) -> tuple[float, float]:
    return (head.width - 1) / 2, (head.height - 1) / 2
