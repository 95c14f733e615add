"""The end of a run: the cause of every missing frame, and the proof of the frames that arrived. Pure logic.

Frames between the two readings of a clock that has jumped cannot be dated: the old and the new time are both possible.
"""

from __future__ import annotations

import math
from collections import defaultdict, deque
from collections.abc import Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace

from vaoi_station.acquisition.cameras.interface import GAIN_TOLERANCE_DB, exposure_tolerance_us
from vaoi_station.acquisition.clocks import ClockJump
from vaoi_station.acquisition.controller.interface import PulseFired
from vaoi_station.acquisition.pairing.evidence import NO_PACKET, Gap, explain_missing, find_gaps, median
from vaoi_station.acquisition.pairing.proof import Kind, TriggerFinding, TriggerProof, prove, questioned_rows
from vaoi_station.acquisition.pairing.run_record import ObservedFrame, ObservedPulse, RunRecord
from vaoi_station.model import FrameRecord, ProgramRow, Verdict
from vaoi_station.model.recording import row_of


@dataclass
class _Outage:
    since_s: float
    until_s: float
    why: str


class Outages:
    """The latest outages and clock jumps of every camera. During an outage the camera is called *away*."""

    def __init__(self) -> None:
        self._jumps: defaultdict[int, deque[ClockJump]] = defaultdict(lambda: deque(maxlen=20))
        self._outages: defaultdict[int, deque[_Outage]] = defaultdict(lambda: deque(maxlen=20))

    def begin(self, camera: int, since_s: float, why: str) -> None:
        """Record that a camera has been away since `since_s`, because of `why`, which is a phrase for messages."""
        self._outages[camera].append(_Outage(since_s, math.inf, why))

    def end(self, camera: int, at_s: float) -> None:
        """Record that a camera delivers again from `at_s` on."""
        for outage in self._outages[camera]:
            outage.until_s = min(outage.until_s, at_s)

    def add_jump(self, camera: int, jump: ClockJump) -> None:
        """Record a jump of a camera's clock."""
        self._jumps[camera].append(jump)

    def jump_between(self, camera: int, first_s: float, last_s: float) -> ClockJump | None:
        """Return the jump of a camera's clock that makes its times between two host times unknown, if there is one."""
        return next((j for j in self._jumps[camera] if j.since_s <= last_s and first_s <= j.until_s), None)

    def is_away(self, camera: int) -> bool:
        """Return whether a camera is away at present."""
        return any(math.isinf(outage.until_s) for outage in self._outages[camera])

    def count_ended(self, camera: int, host_s: float) -> int:
        """Return how many outages and clock jumps of a camera had ended by the host time `host_s`."""
        ends_s = (*(o.until_s for o in self._outages[camera]), *(j.until_s for j in self._jumps[camera]))
        return sum(end_s <= host_s for end_s in ends_s)

    def cause_at(self, camera: int, host_s: float) -> str:
        """Return why a camera was away at the time `host_s`; an empty text if it was not away."""
        return next(
            (f"the camera was lost: {o.why}" for o in self._outages[camera] if o.since_s <= host_s <= o.until_s), ""
        )


ON_TOLERANCE_US = 1.0
"""Accepted difference of an on-time or a width of the trigger, µs: the firmware rounds it to ticks of 0.5 µs."""
SHARE_TOLERANCE = 0.01


def contradicted_rows(pulses: Mapping[int, ObservedPulse], program: Sequence[ProgramRow]) -> dict[int, str]:
    """Return {row: text} for the rows that were filmed otherwise than the program states; empty without a program."""
    found: dict[int, str] = {}
    for row, pulse in sorted(pulses.items()):
        expected = row_of(program, row)
        if expected is not None and (text := contradiction(pulse.event, expected)):
            found[row] = text
    return found


def contradiction(fired: PulseFired, expected: ProgramRow) -> str:
    """Return what a pulse was reported with if the program states something else; an empty text otherwise."""
    if fired.light != expected.light:
        lit = f"light {fired.light!r}" if fired.light else "no light"
        return f"its pulse was fired with {lit}, but the light program has {expected.light!r}"
    if fired.on_us is not None and expected.on_us is not None and abs(fired.on_us - expected.on_us) > ON_TOLERANCE_US:
        return (
            f"light {expected.light!r} was on for {fired.on_us:g} µs, but the light program has {expected.on_us:g} µs"
        )
    is_us, must_us = fired.trigger_us, expected.trigger_us
    if is_us is not None and must_us is not None and abs(is_us - must_us) > ON_TOLERANCE_US:
        return f"its trigger was high for {is_us:g} µs, but the light program has an exposure of {must_us:g} µs"
    for name, unit, reported, stated in (
        ("exposure", " µs", fired.exposures_us, expected.lit_us),
        ("gain", "", fired.gains, expected.gains),
    ):
        for camera, (is_, must) in enumerate(zip(reported, stated, strict=False)):
            if abs(is_ - must) > SHARE_TOLERANCE * must:
                return f"camera {camera} had {name} {is_:g}{unit}, but the light program has {must:g}{unit}"
    return ""


def contradicted_frames(camera: int, frames: Iterable[ObservedFrame], program: Sequence[ProgramRow]) -> dict[int, str]:
    """Return {row: text} for the frames of a camera that state another exposure or gain than the program."""
    if not program:
        return {}
    found: dict[int, str] = {}
    for frame in frames:
        if frame.row is None or (stated := frame.stated) is None:
            continue
        expected = program[frame.row % len(program)]
        must_us, must_db = expected.exposures_us[camera], expected.gains_db[camera]
        # Steps are at least two tolerances apart in one of the two (`filming_plan`): a frame fits one step at most.
        # What a frame states may be no number (NaN), which is not below any limit.
        if not abs(stated.exposure_us - must_us) < exposure_tolerance_us(must_us):
            what = f"an exposure of {stated.exposure_us:g} µs, but the light program has {must_us:g} µs"
        elif stated.gain_db is not None and not abs(stated.gain_db - must_db) < GAIN_TOLERANCE_DB:
            what = f"a gain of {stated.gain_db:g} dB, but the light program has {must_db:g} dB"
        else:
            continue
        found[frame.row] = f"its frame states {what}: the camera's sequencer is at another row"
    return found


MARGIN_PERIODS = 1.5
"""The proof of a run also uses unassigned frames, up to this number of periods before its first and after its last
pulse."""
PREVIOUS_RUN = -1


def judge_run(
    run: RunRecord,
    unassigned: Sequence[Sequence[ObservedFrame]],
    outages: Outages,
    pulse_bound_s: float,
    previous: RunRecord | None = None,
) -> tuple[list[FrameRecord], TriggerProof]:
    """Return the records of the missing frames of a run, and the proof of the run; `run` does not change."""
    missing: list[FrameRecord] = []
    frames, gaps = [], []
    jumped: list[dict[int, str]] = []  # camera → {row: why the frame that was assigned to it cannot be dated}
    taken: list[set[int]] = [set() for _ in unassigned]
    for camera, row in run.taken:
        taken[camera].add(row)
    for camera, extra in enumerate(unassigned):
        jumped.append(_jumped_rows(run, camera, outages))
        dated = [f for f in run.complete_frames[camera] if f.row not in jumped[-1]]
        certain = [f for f in _near_run(run, extra) if _jump_of(f, camera, outages) is None]
        observed = [*dated, *_without_displaced(run, certain, dated, jumped[-1])]
        # Most runs have no outage, and then no frame is copied.
        frames.append([replace(f, epoch=e) if (e := outages.count_ended(camera, f.host_s)) else f for f in observed])
        opening = _opening_gap(run, previous, camera, extra, outages, taken[camera])
        gaps.append([*opening, *_gaps(run, frames[-1], taken[camera])])
        missing += _missing(run, camera, gaps[-1], outages, sum(f.row is None for f in observed))
    unconfirmed = {camera for camera, confirmed in run.latency_known.items() if not confirmed}
    proof = _with_findings(prove(run.pulses, pulse_bound_s, frames, gaps, unconfirmed), "clock-jumped", jumped)
    rows = contradicted_rows(run.pulses, run.program)
    # What the pulse was fired with is stated first; a frame that contradicts as well adds nothing to it.
    contradicted = [
        contradicted_frames(camera, run.complete_frames[camera], run.program) | rows
        for camera in range(len(unassigned))
    ]
    return missing, _with_findings(proof, "other-light", contradicted)


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
    # Under a wrong time the frame may seem to be exposed long before or after the jump; its arrival is certain.
    times_s = (frame.arrived_s, frame.host_s)
    return next((jump for s in times_s if (jump := outages.jump_between(camera, s, s)) is not None), None)


def _jumped_rows(run: RunRecord, camera: int, outages: Outages) -> dict[int, str]:
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
    # A frame whose row was taken by one with an unknown time answered its pulse. As evidence against the trigger it
    # would make the camera appear to run freely.
    if not jumped or not run.pulses:
        return list(unassigned)
    latency_s = median([f.host_s - run.pulses[f.row].host_s for f in dated if f.row is not None] or [0.0])

    def row_of(frame: ObservedFrame) -> int:
        return min(run.pulses, key=lambda row: abs(frame.host_s - latency_s - run.pulses[row].host_s))

    return [frame for frame in unassigned if row_of(frame) not in jumped]


def _with_findings(proof: TriggerProof, kind: Kind, texts: Sequence[Mapping[int, str]]) -> TriggerProof:
    """Return the proof with one more finding for every camera and row that has a text."""
    found = tuple(
        TriggerFinding(camera=camera, row=row, kind=kind, text=text)
        for camera, rows in enumerate(texts)
        for row, text in sorted(rows.items())
    )
    if not found:
        return proof
    cameras = tuple(c.model_copy(update={"proven": c.proven and not texts[c.camera]}) for c in proof.cameras)
    return TriggerProof(proven=False, cameras=cameras, findings=(*proof.findings, *found))


def _near_run(run: RunRecord, unassigned: Sequence[ObservedFrame]) -> list[ObservedFrame]:
    times_s = [pulse.host_s for pulse in run.pulses.values()]
    margin_s = MARGIN_PERIODS * run.period_s
    return [f for f in unassigned if min(times_s) - margin_s <= f.host_s <= max(times_s) + margin_s]


def _gaps(run: RunRecord, frames: Sequence[ObservedFrame], taken: AbstractSet[int]) -> list[Gap]:
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
    fired_s = run.pulses[row].host_s
    # The frame of a pulse arrives within a period; the jump may lie before the one or after the other.
    jump = outages.jump_between(camera, fired_s, fired_s + run.period_s)
    return "" if jump is None else f"{jump} then, so that no frame could be assigned by its time stamp"


def _annotate(run: RunRecord, camera: int, proof: TriggerProof) -> None:
    complete = {row for n, row in run.frames if n == camera and run.frames[n, row].verdict is Verdict.OK}
    for row, text in questioned_rows(proof, camera, complete).items():
        run.frames[camera, row] = run.frames[camera, row].model_copy(update={"cause": text, "proven": False})
