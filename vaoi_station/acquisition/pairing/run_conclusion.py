"""The end of a run: a cause for everything that never came, and the proof of what did. Pure logic."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import replace

from vaoi_station.acquisition.causes import Gap, Outages, explain_missing, gaps
from vaoi_station.acquisition.pairing.proof import TriggerProof, prove, rows_in_question
from vaoi_station.acquisition.pairing.records import Seen
from vaoi_station.acquisition.pairing.run_sheet import RunSheet
from vaoi_station.model import FrameRecord, Verdict

AROUND = 1.5
"""Frames that belong to no pulse count as a run's from so many periods before its first pulse to after its last."""
BEFORE = -1
"""In place of a row: the last one of the run before."""


def conclude(
    sheet: RunSheet,
    extra: Sequence[Sequence[Seen]],
    outages: Outages,
    pulse_bound_s: float,
    before: RunSheet | None = None,
) -> tuple[list[FrameRecord], TriggerProof]:
    """Completes `sheet.frames`; returns what is missing, and the proof.

    Args:
        sheet: a run whose frames have all come, or are waited for no longer.
        extra: of every camera, whole frames that belong to no pulse, of this run or about its time.
        outages: when cameras were away.
        pulse_bound_s: how far the host time of a pulse may be off.
        before: the run before it, from whose last frames the cameras went on counting.
    """
    missing: list[FrameRecord] = []
    seen, counted = [], []
    taken: list[set[int]] = [set() for _ in extra]
    for camera, row in sheet.taken:
        taken[camera].add(row)
    for camera, strays in enumerate(extra):
        frames = [*sheet.seen[camera], *_about(sheet, strays)]
        seen.append([_dated(f, outages.before(camera, f.host_s)) for f in frames])
        opening = _opening(sheet, before, camera, strays, outages, taken[camera])
        counted.append([*opening, *_gaps(sheet, seen[-1], taken[camera])])
        missing += _missing(sheet, camera, counted[-1], outages)
    proof = prove(sheet.pulses, pulse_bound_s, seen, counted)
    for record in missing:
        sheet.frames[record.camera, record.row] = record
    for camera in {finding.camera for finding in proof.findings}:
        _note(sheet, camera, proof)
    return missing, proof


def _dated(frame: Seen, epoch: int) -> Seen:
    return replace(frame, epoch=epoch) if epoch else frame


def _about(sheet: RunSheet, strays: Sequence[Seen]) -> list[Seen]:
    times_s = [pulse.host_s for pulse in sheet.pulses.values()]
    around_s = AROUND * sheet.period_s
    return [s for s in strays if min(times_s) - around_s <= s.host_s <= max(times_s) + around_s]


def _gaps(sheet: RunSheet, seen: Sequence[Seen], taken: AbstractSet[int]) -> list[Gap]:
    """Of one camera, with the rows of which something came. One that was lost and came back counts anew."""
    fired = [row for row in range(sheet.rows) if row not in sheet.skipped]
    ids: defaultdict[int, dict[int, int]] = defaultdict(dict)
    for frame in seen:
        if frame.row is not None and frame.frame_id is not None:
            ids[frame.epoch][frame.row] = frame.frame_id
    torn = taken - {row for of_epoch in ids.values() for row in of_epoch}
    found: list[Gap] = []
    for epoch, of_epoch in sorted(ids.items()):
        strays = [f.frame_id for f in seen if f.row is None and f.epoch == epoch and f.frame_id is not None]
        found += gaps(fired, of_epoch, torn, strays)
    return found


def _opening(
    sheet: RunSheet,
    before: RunSheet | None,
    camera: int,
    strays: Sequence[Seen],
    outages: Outages,
    taken: AbstractSet[int],
) -> list[Gap]:
    """From the last row of the run before to the first frame of this one, if the count of the camera explains it."""
    if before is None:
        return []
    last = next((f for f in before.seen[camera] if f.row == before.rows - 1), None)
    first = min((f for f in sheet.seen[camera]), key=lambda f: f.row or 0, default=None)
    if last is None or first is None or last.frame_id is None or first.frame_id is None or first.row is None:
        return []
    if outages.before(camera, last.host_s) != outages.before(camera, first.host_s):
        return []
    fired = [row for row in range(first.row + 1) if row not in sheet.skipped]
    between = [f.frame_id for f in strays if f.frame_id is not None and last.host_s < f.host_s < first.host_s]
    (gap,) = gaps([BEFORE, *fired], {BEFORE: last.frame_id, first.row: first.frame_id}, taken, between)
    return [gap] if gap.missing and 0 <= gap.ignored <= len(gap.missing) else []


def _missing(sheet: RunSheet, camera: int, between: Sequence[Gap], outages: Outages) -> list[FrameRecord]:
    have = {f.row for f in sheet.seen[camera] if f.row is not None and f.frame_id is not None}
    records = []
    for row in range(sheet.rows):
        if (camera, row) in sheet.frames:
            continue
        if row not in sheet.pulses:
            cause = sheet.skipped.get(row, "the controller's report of this pulse was lost")
        else:
            cause = (
                sheet.refused.get((camera, row))
                or outages.at(camera, sheet.pulses[row].host_s)
                or explain_missing(row, have, between)
            )
        records.append(FrameRecord(camera=camera, row=row, verdict=Verdict.MISSING, cause=cause))
    return records


def _note(sheet: RunSheet, camera: int, proof: TriggerProof) -> None:
    """What speaks against a frame stands with it."""
    whole = {row for n, row in sheet.frames if n == camera and sheet.frames[n, row].verdict is Verdict.OK}
    for row, text in rows_in_question(proof, camera, whole).items():
        sheet.frames[camera, row] = sheet.frames[camera, row].model_copy(update={"cause": text})
