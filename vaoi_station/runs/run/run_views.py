"""Documents of a run for callers: summary, detail and timeline, built from the progress of the run."""

from __future__ import annotations

import platform
from functools import cache

import cv2
import numpy as np

from vaoi_station.geometry import apply
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Stitch, Verdict
from vaoi_station.model.recording import row_of
from vaoi_station.runs.host.machine import clock_state
from vaoi_station.runs.run.order import Order
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.run.verdict import conclude
from vaoi_station.runs.states.run_ids import utc, utc_of_host
from vaoi_station.runs.states.schemas import (
    BarrierTiming,
    BeltSpeed,
    Interruption,
    MadeWith,
    RowTiming,
    RunDetail,
    RunSummary,
    Timeline,
    Timings,
    Unseen,
    VerdictCounts,
    Versions,
)
from vaoi_station.runs.states.tables import FINISHED, IN_MEMORY
from vaoi_station.runs.workers.run_stitcher import Stitched
from vaoi_station.stitching.expectation import StitchTerms
from vaoi_station.version import __version__


@cache
def versions() -> Versions:
    """Return the versions of the software that computes the results."""
    return Versions(station=__version__, opencv=cv2.__version__, python=platform.python_version())


def detail_of(progress: Progress) -> RunDetail:
    """Build the document of a run, which contains everything except its matrices."""
    order, recorded, stitch = progress.order, progress.recorded, progress.stitch
    frames = tuple(progress.frames[key] for key in sorted(progress.frames))
    verdicts, verdict = [frame.verdict for frame in frames], conclude(progress)
    unseen = stitch.quality.get("unseen", {}) if stitch else {}
    return RunDetail(
        id=progress.run,
        board_type=order.board_type.name,
        board_id=progress.board_id,
        job_id=order.job_id,
        state=progress.state,
        verdict=verdict.status,
        started=utc_of_host(progress.barrier_s),
        finished=utc() if progress.state in FINISHED else None,
        rows=recorded.head.rows if recorded else 1 + max(progress.pulses, default=-1),
        cameras=len(order.setup.cameras),
        counts=VerdictCounts(
            ok=sum(frame.usable for frame in frames),
            incomplete=verdicts.count(Verdict.INCOMPLETE),
            missing=verdicts.count(Verdict.MISSING),
            unproven=sum(frame.verdict is Verdict.OK and not frame.proven for frame in frames),
        ),
        reasons=verdict.reasons,
        belt=_belt(progress),
        timings=_timings(progress),
        frames_available=progress.state in IN_MEMORY,
        frames=frames,
        ended=recorded.reason if recorded else "",
        interruptions=tuple(Interruption(blocked_s=b, clear_s=c) for b, c in recorded.interruptions)
        if recorded
        else (),
        strays=recorded.unassigned if recorded else 0,
        proof=recorded.proof if recorded else None,
        software=versions(),
        calibration=order.calibration_digest,
        made_with=_made_with(order),
        bay=progress.context.bay,
        generation=progress.context.generation,
        unseen=tuple(Unseen(address=address, **figures) for address, figures in unseen.items()),
        skipped_boards=(stitch.skipped_boards or ()) if stitch else (),
        came=progress.came,
        flip=order.flip,
        stored=False,  # Set by the archive, which has this information.
    )


def _made_with(order: Order) -> MadeWith:
    clock, reference, setup = clock_state(), order.reference, order.setup
    return MadeWith(
        configuration=order.configuration_digest,
        board_type=order.board_type_digest,
        board_type_revision=order.board_type.revision,
        board_type_state=order.board_type.state,
        method=setup.method,
        reference=reference.run if reference else None,
        reference_digest=reference.digest if reference else None,
        terms=None if order.line is None else StitchTerms.of(order.line, setup.visibility, setup.channels),
        clock_synchronised=clock.synchronised,
        clock_max_error_s=clock.max_error_s,
        time_zone=clock.time_zone,
        utc_offset_s=clock.utc_offset_s,
    )


def summary_of(detail: RunDetail) -> RunSummary:
    """Return the summary of a run: a part of the fields of its document."""
    return RunSummary(**{key: getattr(detail, key) for key in RunSummary.model_fields})


def timeline_of(progress: Progress) -> Timeline:
    """Build the timeline of a run. Its times are in seconds since the board interrupted the barrier."""
    zero, recorded, stitched = progress.barrier_s, progress.recorded, progress.stitched or Stitched(None)
    of_barrier = recorded.interruptions if recorded else ()
    first_s = of_barrier[0][0] if of_barrier else 0.0
    return Timeline(
        frames_settled_s=tuple((*key, at - zero) for key, at in sorted(progress.stitcher.settled_s.items())),
        tasks=stitched.timings,
        last_frame_s=(recorded.last_frame_host_s if recorded else zero) - zero,
        ready_s=None if stitched.ready_s is None else stitched.ready_s - zero,
        rows=_row_timings(progress, first_s) if of_barrier else (),
        barrier=tuple(
            BarrierTiming(blocked_s=b - first_s, clear_s=None if c is None else c - first_s) for b, c in of_barrier
        ),
    )


def _row_timings(progress: Progress, zero: float) -> tuple[RowTiming, ...]:
    head, plan, rows = progress.head, progress.order.plan, []
    assert head is not None, "there are interruptions"
    times_s = head.row_times_s()
    for row, time_s in enumerate(times_s.tolist()):
        step = row_of(plan.program, row) if plan is not None else None
        shutters = (
            step.exposures_us if step is not None else [head.exposure_us(i, row) for i in range(len(head.cameras))]
        )
        rows.append(
            RowTiming(
                row=row,
                pulse_s=time_s - float(times_s[0]) - zero,
                light=head.light(row) or "",
                led_us=None if step is None else step.on_us,
                exposure_us=max(shutters),
            )
        )
    return tuple(rows)


def belt_speed(stitch: Stitch, times_s: Floats, nominal_mm_s: tuple[float, float], about_mm: Floats) -> BeltSpeed:
    """Fit a constant velocity to the positions of one point of the board, one per row.

    `times_s` are those of `RecordingHead.motion_times_s`; `about_mm` is the point in row 0, (2,), tester coordinates.
    """
    positions_mm = np.array([apply(m, about_mm) for m in stitch.row_motion])
    # With centred times, the slope of the fitted line does not depend on its offset: two sums replace a solver.
    centred_s = times_s - times_s.mean()
    vx, vy = centred_s @ positions_mm / (centred_s @ centred_s)
    ratio = float(np.hypot(vx, vy) / np.hypot(*nominal_mm_s))
    return BeltSpeed(nominal_mm_s=nominal_mm_s, measured_mm_s=(float(vx), float(vy)), ratio=ratio)


def _belt(progress: Progress) -> BeltSpeed | None:
    """Return the belt speed at the board's centre; None without a result of at least two rows."""
    stitch, recorded = progress.stitch, progress.recorded
    if stitch is None or recorded is None or len(stitch.row_motion) < 2:
        return None
    # A rotation between rows adds no apparent motion at the board's centre; at the tester's origin it would.
    setup, from_cad = progress.order.setup, stitch.tester_from_cad
    if from_cad is None:
        about_mm = np.mean([c.row_from_image(c.center_px) for c in setup.cameras], axis=0)
    else:
        about_mm = from_cad(np.mean(progress.order.board_type.extent(), axis=0))
    # With an encoder these are the times of a belt at its nominal speed, in which stops do not count.
    return belt_speed(stitch, recorded.head.motion_times_s(), setup.conveyor_mm_s, about_mm)


def _timings(progress: Progress) -> Timings | None:
    if progress.recorded is None or progress.stitched is None:
        return None
    last_s, done = progress.recorded.last_frame_host_s, progress.stitched
    return Timings(
        filming_s=last_s - progress.barrier_s,
        ready_after_last_frame_ms=None if done.ready_s is None else (done.ready_s - last_s) * 1e3,
        links_ms=sum(t.worker_ms for t in done.timings),
        conclude_ms=done.conclude_ms,
        links=len(done.timings),
        links_while_filming=sum(t.done_s + progress.barrier_s < last_s for t in done.timings),
    )
