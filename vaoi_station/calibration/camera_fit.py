"""Calibration of one camera: N_i and lens from detected marks, or a refusal with its cause."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from vaoi_station.calibration.array_assignment import Assignment
from vaoi_station.calibration.camera_prior import RADIAL_PX, CameraPrior
from vaoi_station.calibration.homography_fit import Fit, estimate_homography, fit_camera
from vaoi_station.calibration.mark_detection import DetectedMarks, MarkAppearance, locate_cross, score_limit
from vaoi_station.calibration.mark_identification import Hypothesis
from vaoi_station.calibration.nominal_view import is_in_frame, nominal_matrix
from vaoi_station.calibration.outlier_removal import remove_outliers
from vaoi_station.calibration.plausibility import find_implausibility
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.marks.blur import BLUR_LIMIT_PX
from vaoi_station.model import CameraHead
from vaoi_station.model.reason import Note

MIN_MARKS = 4
_MIN_CONTRAST = 20.0
_MIN_SIZE_PX = 8
_MIN_SHARE = 0.3
"""Least share of the marks expected in a frame that must be found; with fewer, the layout belongs to another board."""
_UNDETERMINED = 0.5
"""A lens is undetermined if its standard deviation after the fit is at least this share of that before the fit."""
_COARSE_PX = 0.2
"""Standard deviation at the frame's corners above which a warning says that the marks are badly distributed."""
_NO_FREEDOM = 0.5


@dataclass(frozen=True, eq=False)
class MarkObservation:
    """A mark of the layout that is expected in the frame: its measured position, or why it was not used."""

    index: int
    """Index of the mark in the layout."""
    expected_px: Floats
    px: Floats | None = None
    residual_px: Floats | None = None
    note: str = ""

    @property
    def used(self) -> bool:
        """Whether the mark is part of the fit."""
        return self.residual_px is not None


@dataclass(frozen=True, eq=False)
class CameraResult:
    """The calibration of one camera: the fit or the cause of the refusal, and all marks."""

    camera: int
    head: CameraHead
    detected: DetectedMarks
    marks: tuple[MarkObservation, ...] = ()
    fit: Fit | None = None
    refusal: str = ""
    """Why the camera was refused, with value and limit; empty if it was calibrated."""
    action: str = ""
    """The action by which the user can remove the cause of the refusal."""
    notes: tuple[Note, ...] = ()
    ambiguous: bool = False
    """Whether the camera was refused because its marks fit the layout in two ways, so that another layout would not
    help."""

    @property
    def used(self) -> int:
        """Number of marks in the fit."""
        return sum(m.used for m in self.marks)

    @property
    def lens_known(self) -> bool:
        """Whether the marks, and not the prior, determine the distortion."""
        return self.fit is not None and self.fit.lens_px[1] <= _UNDETERMINED * RADIAL_PX

    @property
    def corner_sigma_px(self) -> float:
        """Standard deviation in px of projected points at the frame corner where it is largest; NaN without a fit."""
        if self.fit is None:
            return math.nan
        # From the covariance that is written to calibration.json, so that the sentence and the file agree.
        w, h = self.head.width - 1.0, self.head.height - 1.0
        return float(self.fit.sigma_at_px(np.array([[0, 0], [w, 0], [0, h], [w, h]])).max())


@dataclass(frozen=True)
class Limits:
    """Limits that a calibration must satisfy, the known working distance, and the accuracy of the calibration board and
    of nominal views."""

    residual_px: float = 0.2
    """Largest accepted rms residual of one camera."""
    working_distance_mm: float | None = None
    center_tolerance_mm: float = 2.0
    """Accuracy of `nominal_center_mm` relative to the calibration board as it lies, mm: two standard deviations."""
    mark_accuracy_mm: float = 0.0
    """Standard deviation of the positions of marks on the board per axis; 0 if layout.json is exact."""
    flatness_mm: float = 0.0
    """Standard deviation of the calibration board's height within one view, mm; 0 if it is flat."""


def calibrate_camera(
    camera: int,
    head: CameraHead,
    detected: DetectedMarks,
    assignment: Assignment,
    marks_mm: Floats,
    appearance: MarkAppearance,
    limits: Limits,
) -> CameraResult:
    """Calibrate one camera by the detected marks in its frame and their assignment to the layout (k, 2)."""
    # General checks come first, specific ones last: the first cause found is the most useful one for the operator.
    hypothesis = assignment.chosen
    due = _expected_marks(head, camera, detected, hypothesis, marks_mm, appearance)
    if (unfit := _check_size(appearance, head) or _check_frame(detected, hypothesis, due)) is not None:
        return CameraResult(camera, head, detected, due, None, *unfit)
    if assignment.ambiguous:
        refusal, action = _describe_ambiguity(assignment, limits)
        return CameraResult(camera, head, detected, due, None, refusal, action, ambiguous=True)
    assert hypothesis is not None
    pairs = hypothesis.pairs
    # A first homography predicts all marks of the layout, so that marks which the search missed are measured too.
    place = estimate_homography(detected.px[pairs[:, 1]], marks_mm[pairs[:, 0]])
    marks = _measure_expected(
        place if place is not None else hypothesis.similarity, head, detected, hypothesis, marks_mm, appearance
    )
    index, px = [m.index for m in marks if m.px is not None], np.array([m.px for m in marks if m.px is not None])
    prior = CameraPrior(
        ((head.width - 1) / 2, (head.height - 1) / 2),
        math.hypot(head.width, head.height) / 2,
        head.nominal_px_per_mm or 1.0,
        limits.working_distance_mm,
        limits.mark_accuracy_mm,
        limits.flatness_mm,
    )
    fit = fit_camera(marks_mm[index], px, prior)
    if isinstance(fit, Failure):
        action = "Use marks that span the frame in both directions; uncover those that are not detected."
        return CameraResult(camera, head, detected, marks, None, fit.reason, action)
    fit, kept = remove_outliers(fit, marks_mm[index], px)
    result = CameraResult(camera, head, detected, _with_residuals(marks, index, kept, fit), fit)
    refusal, action = _check_fit(result, hypothesis, limits)
    return replace(result, refusal=refusal, action=action, notes=_notes(result, fit, assignment, limits))


def is_frame_usable(detected: DetectedMarks, appearance: MarkAppearance, head: CameraHead) -> bool:
    """Return whether marks can be measured in a frame; if not, its camera is refused with every layout."""
    measurable = detected.contrast >= _MIN_CONTRAST and not detected.blur_px > BLUR_LIMIT_PX
    return measurable and _check_size(appearance, head) is None


def _check_size(appearance: MarkAppearance, head: CameraHead) -> tuple[str, str] | None:
    """Return cause and remedy if marks of this size in px cannot be measured; None if they can."""
    most = min(head.width, head.height) / 2
    if _MIN_SIZE_PX <= appearance.size_px <= most:
        return None
    return (
        f"the layout's marks would be {appearance.size_px:.0f} px large in its frame, but must be {_MIN_SIZE_PX} … "
        f"{most:.0f} px",
        "Correct unit and mark.size in layout.json, or nominal_px_per_mm.",
    )


def _check_frame(
    detected: DetectedMarks, hypothesis: Hypothesis | None, due: tuple[MarkObservation, ...]
) -> tuple[str, str] | None:
    """Return cause and remedy if a frame has too few usable marks; None if it has enough."""
    known = 0 if hypothesis is None else len(hypothesis.pairs)
    if detected.contrast < _MIN_CONTRAST:
        return (
            f"its picture has a contrast of {detected.contrast:.0f} grey levels, "
            f"at least {_MIN_CONTRAST:.0f} are needed",
            "Check light, exposure, lens cap, and that the board lies in its view.",
        )
    if known < MIN_MARKS and detected.opposite > len(detected.px):
        return (
            f"it shows {detected.opposite} marks of the opposite brightness and {len(detected.px)} "
            "of the layout's polarity",
            "Correct mark.polarity in layout.json, on the page “Light marks on a dark board”.",
        )
    if detected.blur_px > BLUR_LIMIT_PX and not len(detected.px):
        return (
            f"it shows no mark, and its steepest edges are blurred by {detected.blur_px:.1f} px (sigma), "
            f"the limit is {BLUR_LIMIT_PX:.1f} px",
            "Focus the lens, and check that the board lies uncovered in its view.",
        )
    if detected.blur_px > BLUR_LIMIT_PX:
        return (
            f"its picture is blurred by {detected.blur_px:.1f} px (sigma), the limit is {BLUR_LIMIT_PX:.1f} px",
            "Focus the lens, and film the board at rest or with a short exposure.",
        )
    if known >= MIN_MARKS:
        return None
    return (
        f"it shows {len(detected.px)} marks, of which {known} fit the layout; at least {MIN_MARKS} are needed"
        + _missing_places(due, hypothesis),
        "Move the board until every camera sees four marks, uncover them, and check that layout.json belongs to this "
        "board and nominal_center_mm to this camera.",
    )


def _missing_places(due: tuple[MarkObservation, ...], hypothesis: Hypothesis | None) -> str:
    """Describe where marks of the layout are expected but were not detected; empty if the assignment is unknown."""
    places = [m.expected_px for m in due if m.px is None] if hypothesis is not None else []
    listed = ", ".join(f"({x:.0f}, {y:.0f})" for x, y in places[:MIN_MARKS])
    more = f" and {len(places) - MIN_MARKS} places more" if len(places) > MIN_MARKS else ""
    return f"; no whole mark is seen at {listed} px{more}, where the layout has one" if places else ""


def _check_fit(result: CameraResult, hypothesis: Hypothesis, limits: Limits) -> tuple[str, str]:
    """Return cause and remedy if a fit is not plausible. Return two empty strings if it is plausible."""
    fit = result.fit
    assert fit is not None
    wrong = "Check that layout.json belongs to this board, its unit, and that it is written as cameras see the board."
    if result.used < _MIN_SHARE * len(result.marks):
        return (
            f"it shows {result.used} of the {len(result.marks)} marks that the layout puts into its frame, "
            f"at least {math.ceil(_MIN_SHARE * len(result.marks))} are needed",
            wrong,
        )
    foreign = len(result.detected.px) - len(hypothesis.pairs)
    if foreign > result.used:
        return f"it shows {foreign} marks that are not in the layout, more than the {result.used} that are", wrong
    if fit.rms_px > limits.residual_px:
        return (
            f"its residuals are {fit.rms_px:.2f} px (rms, {result.used} marks), "
            f"the limit is {limits.residual_px:.2f} px",
            wrong + " A print can be off too: see the picture.",
        )
    why = find_implausibility(fit.matrix, result.head, limits.working_distance_mm)
    return ("", "") if why is None else (why, wrong)


def _expected_marks(
    head: CameraHead,
    camera: int,
    detected: DetectedMarks,
    hypothesis: Hypothesis | None,
    marks_mm: Floats,
    appearance: MarkAppearance,
) -> tuple[MarkObservation, ...]:
    """List the marks expected in the frame of a refused camera, with the positions of those that were detected."""
    px = apply(hypothesis.similarity if hypothesis else nominal_matrix(head, camera), marks_mm)
    known = {int(k): detected.px[n] for k, n in hypothesis.pairs} if hypothesis else {}
    due = sorted({*np.flatnonzero(is_in_frame(head, px, appearance.margin_px)).tolist(), *known})
    return tuple(MarkObservation(k, px[k], known.get(k)) for k in due)


def _measure_expected(
    matrix: Floats,
    head: CameraHead,
    detected: DetectedMarks,
    hypothesis: Hypothesis,
    marks_mm: Floats,
    appearance: MarkAppearance,
) -> tuple[MarkObservation, ...]:
    """Return all marks expected in the frame; those that were not detected are measured at their predicted position."""
    expected, known = apply(matrix, marks_mm), {int(k): int(n) for k, n in hypothesis.pairs}
    least = score_limit(detected.score)
    marks = []
    due = np.flatnonzero(is_in_frame(head, expected, appearance.margin_px))
    for k in sorted({*due.tolist(), *known}):
        if k in known:
            marks.append(MarkObservation(k, expected[k], detected.px[known[k]]))
            continue
        mark = locate_cross(detected.grey, expected[k], appearance)
        note = ""
        if isinstance(mark, Failure):
            note = f"not found ({mark.reason})"
        elif mark.light != appearance.light or mark.score < least:
            note = f"less similar than the others (correlation {mark.score:.2f})"
        # The prediction is accurate to a few pixels. Anything further away than a quarter of a mark is another object.
        elif np.hypot(*(mark.px - expected[k])) > 0.25 * appearance.size_px:
            note = "not at its predicted position"
        px = None if note or isinstance(mark, Failure) else mark.px
        marks.append(MarkObservation(k, expected[k], px, note=note))
    return tuple(marks)


def _with_residuals(
    marks: tuple[MarkObservation, ...], index: list[int], kept: list[int], fit: Fit
) -> tuple[MarkObservation, ...]:
    """Return the marks with the residuals of the fit. Marks that the fit excluded get a note instead."""
    residual = {index[k]: fit.residuals_px[n] for n, k in enumerate(kept)}

    def known(m: MarkObservation) -> MarkObservation:
        if m.px is None:
            return m
        if m.index not in residual:
            return replace(m, note="inconsistent with the others")
        return replace(m, expected_px=m.px - residual[m.index], residual_px=residual[m.index])

    return tuple(map(known, marks))


def _notes(result: CameraResult, fit: Fit, assignment: Assignment, limits: Limits) -> tuple[Note, ...]:
    """List unused marks, what the marks did not determine, and what only the nominal view decided."""
    unused = [("expected at", m.expected_px, f"is {m.note}") for m in result.marks if not m.used]
    unused += [
        ("at", np.array(at), why)
        for at, why in result.detected.doubtful
        if all(m.used or np.hypot(*(m.expected_px - at)) > 10 for m in result.marks)
    ]
    notes = []
    for where, (x, y), why in unused:
        place = f"{x:.0f}, {y:.0f}"
        notes.append(Note("mark-unused", f"the mark {where} ({place}) px {why}; not used", at_px=place))
    if fit.freedom < _NO_FREEDOM:
        sentence = "four marks determine N without redundancy: its residuals are always 0 and do not check it"
        notes.append(Note("four-marks", sentence))
    if not result.lens_known:
        count, sigma = result.used, f"{result.corner_sigma_px:.1f}"
        named = {4: "four", 5: "five", 6: "six", 7: "seven", 8: "eight"}.get(count, str(count))
        sentence = f"{named} marks do not determine the lens: ± {sigma} px at the corners (1 σ); film 9 or more marks"
        notes.append(Note("lens-undetermined", sentence, count=count, sigma_px=sigma))
    elif result.corner_sigma_px > _COARSE_PX:
        sigma = f"{result.corner_sigma_px:.2f}"
        sentence = (
            f"its marks leave the corners of the frame uncertain by ± {sigma} px (1 σ); film marks up to the corners"
        )
        notes.append(Note("corners-uncertain", sentence, sigma_px=sigma))
    tolerance = f"{limits.center_tolerance_mm:g}"
    if assignment.by_nominal_view:
        x, y = assignment.shift_mm
        shift = f"{x:.1f}, {y:.1f}"
        sentence = (
            f"the layout shifted by ({shift}) mm explains its marks as well; nominal_center_mm, good to "
            f"± {tolerance} mm as stated, decided"
        )
        notes.append(Note("nominal-view-decided", sentence, shift_mm=shift, tolerance_mm=tolerance))
    off = 0.0 if assignment.chosen is None else float(np.hypot(*assignment.chosen.offset_mm))
    if off > limits.center_tolerance_mm:
        sentence = f"its view lies {off:.1f} mm off nominal_center_mm, more than the stated ± {tolerance} mm"
        notes.append(Note("view-off-nominal", sentence, off_mm=f"{off:.1f}", tolerance_mm=tolerance))
    return tuple(notes)


def _describe_ambiguity(assignment: Assignment, limits: Limits) -> tuple[str, str]:
    """Return cause and remedy for a camera whose frame and nominal view leave two assignments of the marks possible."""
    x, y = assignment.shift_mm
    return (
        f"its marks fit the layout in two ways: shifted by ({x:.1f}, {y:.1f}) mm it explains them as well, and "
        f"nominal_center_mm is known to ± {limits.center_tolerance_mm:g} mm only",
        "Uncover and clean the marks at the rim of the pattern, or state with --center-tolerance-mm how well "
        f"nominal_center_mm is known for the board as it lies (below {math.hypot(x, y) / 2:.1f} mm), or use a layout "
        "that does not repeat (vaoi calibration-board).",
    )
