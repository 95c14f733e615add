"""Compare the station's verdict on a drawing with the truth, and name what was found."""

from __future__ import annotations

import time
import traceback
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from tests.hostile.drawing import draw
from tests.hostile.filming import Film, film, taught
from tests.hostile.rule import least_seen, why_impossible
from vaoi_station.errors import InputError
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Status, Stitch
from vaoi_station.stitching.board.reference import Reference
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.recordings.references import with_confirmed_orientation
from vaoi_station.stitching.work import StitchSetup, TaskRunner, all_tasks

CLASSES = {
    "too-sure": "`ok`, and the rms error of positions exceeds 3 times its rms σ",
    "outlier": "`ok`, and a component is beyond the limit corrected for the number of comparisons",
    "wrong": "`ok`, and a position is off by more than 0.3 px",
    "unseen": "`ok`, and a component is not in view as the verdict demands",
    "exception": "an exception, or a warning of numpy",
    "refused": "`degraded` or `failed`, although the rule expects a right answer",
}
"""Classes of finds."""
OK_AND_WRONG = ("too-sure", "outlier", "wrong", "unseen")
SURE_RATIO, WRONG_PX, FALSE_ALARM = 3.0, 0.3, 1e-4
"""Limits of rms error over rms σ and of an error, and the probability that a right run is called an outlier."""
UNSEEN_SHARE = 0.95
"""Share of a footprint below which `ok` is a find; the station demands 0.99, and estimates it from its own matrices."""


@dataclass
class Outcome:
    """The outcome of one drawing. `finds` are keys of `CLASSES`."""

    seed: int
    expected: bool = False
    impossible: tuple[str, ...] = ()
    mistakes: tuple[str, ...] = ()
    status: str = ""
    reasons: tuple[str, ...] = ()
    codes: tuple[str, ...] = ()
    """Codes of the reasons of a result, in their order."""
    wrong: tuple[str, ...] = ()
    """The classes of `OK_AND_WRONG` to which the result would belong if it were `ok`; none without positions."""
    views: int = 0
    rms_px: float = 0.0
    sigma_px: float = 0.0
    worst_px: float = 0.0
    worst_component: str = ""
    worst_sigma: float = 0.0
    """Longest error in standard deviations."""
    seconds: float = 0.0
    finds: tuple[str, ...] = ()
    messages: tuple[str, ...] = field(default=())

    def document(self) -> dict[str, Any]:
        """Return the outcome for JSON."""
        return {k: round(v, 4) if isinstance(v, float) else v for k, v in asdict(self).items()}


def judge(seed: int) -> Outcome:
    """Film and stitch the drawing of a seed, and compare the verdict with the truth."""
    started = time.perf_counter()
    drawing = draw(seed)
    outcome = Outcome(seed, mistakes=tuple(str(m) for m in drawing.mistakes))
    try:
        filmed = film(drawing)
    except InputError as refusal:  # `vaoi calibrate` refuses pictures of its marks that are blurred
        outcome.expected = all(m.within for m in drawing.mistakes)
        outcome.status, outcome.reasons = "refused", (str(refusal),)
        outcome.finds = ("refused",) if outcome.expected else ()
        return outcome
    outcome.impossible = why_impossible(filmed)
    outcome.expected = not outcome.impossible
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        # Any exception but a refusal of bad input is a find, whatever its type.
        try:
            compare(outcome, filmed, *stitched(filmed))
        except InputError as refusal:
            outcome.status, outcome.reasons = "refused", (str(refusal),)
        except Exception:  # noqa: BLE001
            outcome.status, outcome.messages = "exception", (traceback.format_exc(limit=-4),)
    outcome.messages += tuple(sorted({f"{w.category.__name__}: {w.message} ({w.filename}:{w.lineno})" for w in warned}))
    found, ok = _found(outcome, filmed), outcome.status == Status.OK.value
    outcome.wrong = tuple(name for name in OK_AND_WRONG if found[name] and outcome.views)
    outcome.finds = tuple(name for name, is_so in found.items() if is_so and (ok or name not in OK_AND_WRONG))
    outcome.seconds = time.perf_counter() - started
    return outcome


def _found(o: Outcome, filmed: Film) -> dict[str, bool]:
    """Return for each class whether the outcome belongs to it; for those of `OK_AND_WRONG`, if it were `ok`."""
    limit = np.sqrt(-2 * np.log(FALSE_ALARM / max(o.views, 1)))
    return {
        "too-sure": o.rms_px > SURE_RATIO * o.sigma_px,
        "outlier": o.worst_sigma > limit,
        "wrong": o.worst_px > WRONG_PX,
        "unseen": least_seen(filmed, borders=False) < UNSEEN_SHARE,
        "exception": bool(o.messages),
        "refused": o.expected and o.status != Status.OK.value,
    }


def stitched(filmed: Film) -> tuple[Stitch, Findings]:
    """Stitch the film as the station does, with a taught reference if the drawing has one."""
    cameras = filmed.calibration.cameras(filmed.head.cameras)
    head = filmed.head
    reference, frame_of = None, None
    if filmed.drawing.mistake("reference") is not None:
        earlier = taught(filmed)
        stitch = with_confirmed_orientation(stitched(earlier)[0])
        sigma_px = stitch.quality.get("cad_sigma_px")
        # The station refuses to teach a run that is not ok.
        if stitch.status is Status.OK and sigma_px is not None:
            reference = Reference(stitch, frozenset(earlier.frames), "taught", float(sigma_px))
            frame_of = _frame_of(earlier)
    setup = StitchSetup(cameras, head.conveyor_mm_s, head.trigger_period_s, filmed.board_type, reference=reference)
    present, times_s = sorted(filmed.frames), head.row_times_s()
    runner = TaskRunner(setup, _frame_of(filmed), frame_of)
    evidence = [runner.perform(task) for task in all_tasks(present, dict(enumerate(times_s)), setup)]
    return runner.conclude_with_findings(times_s, present, evidence)


def _frame_of(filmed: Film) -> Callable[[int, int], Any]:
    return lambda camera, row: filmed.frames.get((camera, row))


def compare(o: Outcome, filmed: Film, stitch: Stitch, findings: Findings) -> None:
    """Enter verdict, errors and predicted errors of all views into the outcome."""
    o.status, o.reasons, o.codes = stitch.status.value, stitch.reasons, tuple(map(str, stitch.reason_codes))
    places = filmed.places_mm
    errors: list[Floats] = []
    covariances, names = [], []
    for ref, views in (stitch.components or {}).items():
        for i, j, x, y in views:
            covariance = findings.sigma.views.get(ref, {}).get((i, j))
            if ref not in places or covariance is None:
                continue
            errors.append(np.array((x, y)) - filmed.true_px((i, j), places[ref][None])[0])
            covariances.append(covariance)
            names.append(ref)
    if not errors:
        return
    e, s = np.array(errors), np.array(covariances)
    length, distance = np.hypot(*e.T), np.sqrt(np.einsum("ki,kij,kj->k", e, np.linalg.inv(s), e))
    o.views, o.worst_px, o.worst_sigma = len(e), float(length.max()), float(distance.max())
    o.worst_component = names[int(length.argmax())]
    o.rms_px = float(np.sqrt((length**2).mean()))
    o.sigma_px = float(np.sqrt(np.trace(s, axis1=1, axis2=2).mean()))
