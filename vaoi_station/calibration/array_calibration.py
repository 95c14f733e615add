"""Calibration of the array from frames of the calibration board; section 3.2, equation 10."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from vaoi_station.calibration.array_assignment import assign_array
from vaoi_station.calibration.blank_ground import BlankGround, find_blank_ground
from vaoi_station.calibration.camera_fit import MIN_MARKS, CameraResult, Limits, calibrate_camera, is_frame_usable
from vaoi_station.calibration.layout_variants import find_symmetries, vary_layout
from vaoi_station.calibration.mark_detection import DetectedMarks, MarkAppearance, detect_marks
from vaoi_station.calibration.mark_identification import Hypothesis, find_hypotheses
from vaoi_station.calibration.nominal_view import nominal_matrix
from vaoi_station.calibration.plausibility import local_scales, print_scale_note
from vaoi_station.errors import InputError, InternalError
from vaoi_station.files.calibrations import Layout
from vaoi_station.files.images import Image
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Calibration, CameraHead, Distortion
from vaoi_station.model.reason import Note
from vaoi_station.pixel_formats import eight_bit_grey

_NEGLIGIBLE_PX = 1e-3
"""A lens whose distortion at the corner is below this is written as ideal, because it is faster to project."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """The calibrations of all cameras of an array. A camera that is not calibrated has a cause instead."""

    cameras: tuple[CameraResult, ...]
    limits: Limits
    hint: str = ""
    """For refused cameras: a change of the layout with which all cameras could be calibrated; empty if none is
    known."""
    ambiguous: tuple[str, ...] = ()
    """Reflections and rotations that map the layout onto itself, so that no frame can exclude them."""

    @property
    def refused(self) -> bool:
        """Whether any camera was refused. There is then no calibration."""
        return any(c.refusal for c in self.cameras)

    @property
    def notes(self) -> tuple[Note, ...]:
        """All warnings. A warning that concerns several cameras appears once and lists these cameras."""
        whose: dict[Note, list[int]] = {}
        for c in self.cameras:
            for note in c.notes:
                whose.setdefault(note, []).append(c.camera)
        notes = []
        for note, numbers in whose.items():
            cameras = ", ".join(map(str, numbers))
            sentence = f"camera{'s' * (len(numbers) > 1)} {cameras}: {note}"
            notes.append(Note(note.code, sentence, cameras=cameras, **note.values))
        fits = [(c.fit.matrix, c.head) for c in self.cameras if c.fit is not None]
        ratios = [np.sqrt(np.prod(local_scales(n, head))) / (head.nominal_px_per_mm or 1.0) for n, head in fits]
        about_print = print_scale_note(float(np.median(ratios))) if ratios else None
        if about_print is not None:
            notes.append(about_print)
        if self.ambiguous:
            sentence = (
                f"the layout {' or '.join(self.ambiguous)} is the same layout, so the orientation of layout.json "
                "cannot be checked; one additional mark off the pattern would make it unambiguous"
            )
            notes.append(Note("layout-symmetric", sentence))
        return tuple(notes)

    def error(self) -> InputError:
        """Return an InputError that lists all refused cameras with causes and remedies."""
        refused = [c for c in self.cameras if c.refusal]
        reasons = "; ".join(f"camera {c.camera}: {c.refusal}" for c in refused)
        actions = " ".join(dict.fromkeys(c.action for c in refused))
        return InputError(f"{reasons}.", action=self.hint or actions, code="not-calibrated")

    def calibration(self, created: datetime | None = None) -> Calibration:
        """Return the calibration with residuals and covariances. Raise `error()` if any camera was refused."""
        if self.refused:
            raise self.error()
        fits = [c.fit for c in self.cameras if c.fit is not None]
        if len(fits) != len(self.cameras):
            raise InternalError("a camera was neither calibrated nor refused")
        bent = any(np.abs(fit.lens.radial).max() * fit.lens.radius_px > _NEGLIGIBLE_PX for fit in fits)
        return Calibration(
            format="vaoi-calibration",
            version=1,
            unit="mm",
            camera_matrices=tuple(fit.matrix for fit in fits),
            working_distance_mm=self.limits.working_distance_mm,
            residual_px=tuple(round(fit.rms_px, 5) for fit in fits),
            principal_point=tuple(fit.lens.center_px for fit in fits),
            created=(created or datetime.now(UTC)).strftime("%Y-%m-%dT%H:%M:%SZ"),
            covariances=[fit.covariance.tolist() for fit in fits],
            covariance=tuple(fit.field_covariance_px2 for fit in fits),
            distortion=tuple(
                Distortion(center=fit.lens.center_px, radius=fit.lens.radius_px, radial=fit.lens.radial) for fit in fits
            )
            if bent
            else None,
        )


def calibrate(
    heads: Sequence[CameraHead],
    frame_of: Callable[[int], Image | None],
    layout: Layout,
    limits: Limits | None = None,
) -> Outcome:
    """Calibrate an array from one frame per camera of a board, whose coordinates become the tester's.

    A missing frame or nominal view raises InputError. A camera that is refused because of the content of its frame
    raises none: the outcome contains the cause.
    """
    limits = limits or Limits()
    kinds, detections = [], []
    for camera, head in enumerate(heads):
        nominal = nominal_matrix(head, camera)
        kinds.append(MarkAppearance.of(layout, float(np.hypot(nominal[0, 0], nominal[1, 0]))))
        frame = frame_of(camera)
        if frame is None:
            raise InputError(
                f"camera {camera}: its frame of the calibration board is listed as missing.",
                action="Film the board again; every camera is needed.",
            )
        detections.append(detect_marks(eight_bit_grey(frame), kinds[camera]))
    grounds = [find_blank_ground(found, kind) for found, kind in zip(detections, kinds, strict=True)]
    board = _FilmedBoard(heads, detections, kinds, grounds, limits)
    marks_mm = np.array([(m.x, m.y) for m in layout.marks]) * layout.mm_per_unit
    results = tuple(board.calibrated(marks_mm, [board.hypotheses(i, marks_mm) for i in range(len(heads))]))
    # The search for a hint calibrates the array once for each variant, so it runs only after a refusal.
    unfit = any(c.refusal and not c.ambiguous for c in results)
    hint = board.layout_hint(marks_mm) if unfit else ""
    return Outcome(results, limits, hint, find_symmetries(marks_mm, layout.mark.size * layout.mm_per_unit / 4))


@dataclass(frozen=True, eq=False)
class _FilmedBoard:
    """What the frames of all cameras show of the calibration board, independent of its layout."""

    heads: Sequence[CameraHead]
    detections: list[DetectedMarks]
    kinds: list[MarkAppearance]
    grounds: list[BlankGround]
    limits: Limits

    def hypotheses(self, camera: int, marks_mm: Floats) -> tuple[Hypothesis, ...]:
        """Return the hypotheses about which mark of a camera's frame is which mark of a layout."""
        head, size_px = self.heads[camera], self.kinds[camera].size_px
        return find_hypotheses(self.detections[camera].px, marks_mm, head, camera, size_px, self.grounds[camera])

    def calibrated(self, marks_mm: Floats, options: Sequence[tuple[Hypothesis, ...]]) -> Iterator[CameraResult]:
        """Calibrate the cameras by a layout, each when its result is asked for."""
        assignments = assign_array(options, self.heads, self.limits.center_tolerance_mm)
        for i, (head, assignment) in enumerate(zip(self.heads, assignments, strict=True)):
            yield calibrate_camera(i, head, self.detections[i], assignment, marks_mm, self.kinds[i], self.limits)

    def layout_hint(self, marks_mm: Floats) -> str:
        """Return a sentence that names changes of the layout with which all cameras would be calibrated; "" if none."""
        frames = zip(self.detections, self.kinds, self.heads, strict=True)
        if not all(is_frame_usable(found, kind, head) for found, kind, head in frames):
            return ""
        fitting = [way for way, changed in vary_layout(marks_mm, self.heads) if self._fits(changed)]
        if not fitting:
            return ""
        ways = " or ".join(dict.fromkeys(fitting))
        return f"The marks fit the layout {ways}: write layout.json as the cameras see the board, or turn the board."

    def _fits(self, marks_mm: Floats) -> bool:
        # Most variants fit no camera: the first camera that is refused decides.
        options = []
        for camera in range(len(self.heads)):
            options.append(self.hypotheses(camera, marks_mm))
            if all(len(hypothesis.pairs) < MIN_MARKS for hypothesis in options[camera]):
                return False
        return not any(result.refusal for result in self.calibrated(marks_mm, options))
