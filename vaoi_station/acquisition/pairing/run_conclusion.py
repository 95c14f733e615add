"""The end of a run: find the cause of every missing frame, and prove the frames that arrived. Pure logic."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import replace

from vaoi_station.acquisition.causes import NO_PACKET, Gap, explain_missing, find_gaps
from vaoi_station.acquisition.clocks import ClockJump
from vaoi_station.acquisition.outages import Outages
from vaoi_station.acquisition.pairing.clock_fit import median
from vaoi_station.acquisition.pairing.light_check import contradicted_frames, contradicted_rows
from vaoi_station.acquisition.pairing.proof import TriggerFinding, TriggerProof, prove, questioned_rows
from vaoi_station.acquisition.pairing.run_record import ObservedFrame, RunRecord
from vaoi_station.model import FrameRecord, Verdict

MARGIN_PERIODS = 1.5
"""The proof of a run also uses unassigned frames, up to this number of periods before its first and after its last
pulse."""
PREVIOUS_RUN = -1
"""Row number that means "the last row of the previous run"."""


def judge_run(
    run: RunRecord,
    unassigned: Sequence[Sequence[ObservedFrame]],
    outages: Outages,
    pulse_bound_s: float,
    previous: RunRecord | None = None,
) -> tuple[list[FrameRecord], TriggerProof]:
    """Return the records of the missing frames of a run, and the proof of the run; `run` does not change.

    Args:
        run: a run whose frames have all arrived, or are no longer awaited.
        unassigned: complete frames of every camera that belong to no pulse; not only those from the time of this run.
        outages: when cameras were away.
        pulse_bound_s: largest error of a pulse's host time.
        previous: the run before this one; the cameras continue to count from its last frame ids.
    """
    missing: list[FrameRecord] = []
    frames, gaps = [], []
    jumped: list[dict[int, str]] = []
    """Camera → {row: why the frame that was assigned to it cannot be dated}."""
    taken: list[set[int]] = [set() for _ in unassigned]
    for camera, row in run.taken:
        taken[camera].add(row)
    for camera, extra in enumerate(unassigned):
        jumped.append(_jumped_rows(run, camera, outages))
        dated = [f for f in run.complete_frames[camera] if f.row not in jumped[-1]]
        certain = [f for f in _near_run(run, extra) if _jump_of(f, camera, outages) is None]
        observed = [*dated, *_without_displaced(run, certain, dated, jumped[-1])]
        frames.append([_with_epoch(f, outages.count_ended(camera, f.host_s)) for f in observed])
        opening = _opening_gap(run, previous, camera, extra, outages, taken[camera])
        gaps.append([*opening, *_gaps(run, frames[-1], taken[camera])])
        missing += _missing(run, camera, gaps[-1], outages, sum(f.row is None for f in observed))
    unconfirmed = {camera for camera, confirmed in run.latency_known.items() if not confirmed}
    proof = _with_jumps(prove(run.pulses, pulse_bound_s, frames, gaps, unconfirmed), jumped)
    rows = contradicted_rows(run.pulses, run.program)
    # What the pulse was fired with is stated first; a frame that contradicts as well adds nothing to it.
    contradicted = [
        contradicted_frames(camera, run.complete_frames[camera], run.program) | rows
        for camera in range(len(unassigned))
    ]
    return missing, _with_lights(proof, contradicted)


def cameras_in_doubt(proof: TriggerProof) -> frozenset[int]:
    """Return the cameras with findings that a jump of their clock may explain."""
    return frozenset(f.camera for f in proof.findings if f.kind not in ("other-light", "clock-jumped"))


def conclude_run(run: RunRecord, missing: Sequence[FrameRecord], proof: TriggerProof) -> None:
    """Add to `run.frames` what `judge_run` returned: the missing frames, and the doubts about frames that arrived."""
    for record in missing:
        run.frames[record.camera, record.row] = record
    for camera in {finding.camera for finding in proof.findings}:
        _annotate(run, camera, proof)


def _jump_of(frame: ObservedFrame, camera: int, outages: Outages) -> ClockJump | None:
    """Return the clock jump that makes the time of a frame unknown, if there is one."""
    # Under a wrong time the frame may seem to be exposed long before or after the jump; its arrival is certain.
    times_s = (frame.arrived_s, frame.host_s)
    return next((jump for s in times_s if (jump := outages.jump_between(camera, s, s)) is not None), None)


def _jumped_rows(run: RunRecord, camera: int, outages: Outages) -> dict[int, str]:
    """Return {row: finding} for the assigned frames of a camera whose time is unknown because its clock jumped."""
    return {
        frame.row: f"{jump} before, during or after its exposure, so that the frame may be of another pulse"
        for frame in run.complete_frames[camera]
        if frame.row is not None and (jump := _jump_of(frame, camera, outages)) is not None
    }


def _without_displaced(
    run: RunRecord,
    unassigned: Sequence[ObservedFrame],
    dated: Sequence[ObservedFrame],
    jumped: Mapping[int, str],
) -> list[ObservedFrame]:
    """Return the unassigned frames except those whose row was taken by a frame with an unknown time.

    Such a frame answered its pulse. As evidence against the trigger it would make the camera appear to run freely.
    """
    if not jumped or not run.pulses:
        return list(unassigned)
    latency_s = median([f.host_s - run.pulses[f.row].host_s for f in dated if f.row is not None] or [0.0])

    def row_of(frame: ObservedFrame) -> int:
        return min(run.pulses, key=lambda row: abs(frame.host_s - latency_s - run.pulses[row].host_s))

    return [frame for frame in unassigned if row_of(frame) not in jumped]


def _with_jumps(proof: TriggerProof, jumped: Sequence[Mapping[int, str]]) -> TriggerProof:
    """Return the proof with a finding for every frame whose time is unknown because its camera's clock jumped."""
    found = tuple(
        TriggerFinding(camera=camera, row=row, kind="clock-jumped", text=text)
        for camera, rows in enumerate(jumped)
        for row, text in sorted(rows.items())
    )
    if not found:
        return proof
    cameras = tuple(c.model_copy(update={"proven": c.proven and not jumped[c.camera]}) for c in proof.cameras)
    return TriggerProof(proven=False, cameras=cameras, findings=(*proof.findings, *found))


def _with_lights(proof: TriggerProof, contradicted: Sequence[Mapping[int, str]]) -> TriggerProof:
    """Return the proof with a finding for every camera and row that was not filmed as the light program states."""
    found = tuple(
        TriggerFinding(camera=camera, row=row, kind="other-light", text=text)
        for camera, rows in enumerate(contradicted)
        for row, text in sorted(rows.items())
    )
    if not found:
        return proof
    cameras = tuple(c.model_copy(update={"proven": c.proven and not contradicted[c.camera]}) for c in proof.cameras)
    return TriggerProof(proven=False, cameras=cameras, findings=(*proof.findings, *found))


def _with_epoch(frame: ObservedFrame, epoch: int) -> ObservedFrame:
    return replace(frame, epoch=epoch) if epoch else frame


def _near_run(run: RunRecord, unassigned: Sequence[ObservedFrame]) -> list[ObservedFrame]:
    times_s = [pulse.host_s for pulse in run.pulses.values()]
    margin_s = MARGIN_PERIODS * run.period_s
    return [f for f in unassigned if min(times_s) - margin_s <= f.host_s <= max(times_s) + margin_s]


def _gaps(run: RunRecord, frames: Sequence[ObservedFrame], taken: AbstractSet[int]) -> list[Gap]:
    """Return the intervals between the frames of one camera. `taken` lists the rows of which a frame arrived."""
    fired = [row for row in range(run.rows) if row not in run.skipped]
    # A camera restarts its frame ids after an outage, so ids are compared within an epoch only.
    ids: defaultdict[int, dict[int, int]] = defaultdict(dict)
    for frame in frames:
        if frame.row is not None and frame.frame_id is not None:
            ids[frame.epoch][frame.row] = frame.frame_id
    incomplete = taken - {row for of_epoch in ids.values() for row in of_epoch}
    found: list[Gap] = []
    for epoch, of_epoch in sorted(ids.items()):
        unassigned_ids = [f.frame_id for f in frames if f.row is None and f.epoch == epoch and f.frame_id is not None]
        found += find_gaps(fired, of_epoch, incomplete, unassigned_ids)
    return found


def _opening_gap(
    run: RunRecord,
    previous: RunRecord | None,
    camera: int,
    unassigned: Sequence[ObservedFrame],
    outages: Outages,
    taken: AbstractSet[int],
) -> list[Gap]:
    """Return the gap between the previous run's last frame and this run's first, if it explains a missing frame."""
    if previous is None:
        return []
    last = next((f for f in previous.complete_frames[camera] if f.row == previous.rows - 1), None)
    first = min((f for f in run.complete_frames[camera]), key=lambda f: f.row or 0, default=None)
    if last is None or first is None or last.frame_id is None or first.frame_id is None or first.row is None:
        return []
    if outages.count_ended(camera, last.host_s) != outages.count_ended(camera, first.host_s):
        return []
    fired = [row for row in range(first.row + 1) if row not in run.skipped]
    between = [f.frame_id for f in unassigned if f.frame_id is not None and last.host_s < f.host_s < first.host_s]
    ids = {PREVIOUS_RUN: last.frame_id, first.row: first.frame_id}
    (gap,) = find_gaps([PREVIOUS_RUN, *fired], ids, taken, between)
    # A camera may restart its ids between runs (AcquisitionStart does that), so a count that does not fit is ignored.
    return [gap] if gap.missing and 0 <= gap.unanswered <= len(gap.missing) else []


def _missing(run: RunRecord, camera: int, gaps: Sequence[Gap], outages: Outages, unassigned: int) -> list[FrameRecord]:
    numbered = {f.row for f in run.complete_frames[camera] if f.row is not None and f.frame_id is not None}
    records = []
    for row in range(run.rows):
        if (camera, row) in run.frames:
            continue
        if row not in run.pulses:
            skipped = run.skipped.get(row)
            cause = "the controller's report of this pulse was lost" if skipped is None else skipped.reason
        else:
            cause = (
                run.refused.get((camera, row))
                or outages.cause_at(camera, run.pulses[row].host_s)
                or _jump_cause(run, camera, row, outages)
                or (NO_PACKET if camera in run.silent else "")
                or explain_missing(row, numbered, gaps, unassigned)
            )
        records.append(FrameRecord(camera=camera, row=row, verdict=Verdict.MISSING, cause=cause))
    return records


def _jump_cause(run: RunRecord, camera: int, row: int, outages: Outages) -> str:
    """Return why a row has no frame if its camera's clock jumped then; an empty text otherwise."""
    fired_s = run.pulses[row].host_s
    # The frame of a pulse arrives within a period; the jump may lie before the one or after the other.
    jump = outages.jump_between(camera, fired_s, fired_s + run.period_s)
    return "" if jump is None else f"{jump} then, so that no frame could be assigned by its time stamp"


def _annotate(run: RunRecord, camera: int, proof: TriggerProof) -> None:
    """Mark every complete frame that the findings put in doubt as not proven, with these findings as its cause."""
    complete = {row for n, row in run.frames if n == camera and run.frames[n, row].verdict is Verdict.OK}
    for row, text in questioned_rows(proof, camera, complete).items():
        run.frames[camera, row] = run.frames[camera, row].model_copy(update={"cause": text, "proven": False})
