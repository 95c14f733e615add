"""Score one board's run against the twin's truth and against the faults that the rig injected."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from vaoi_station.demo.truth_comparison import compare_with_truth
from vaoi_station.rig.line.virtual_line import BoardPassage, FrameOutcome, Lighting
from vaoi_station.rig.scoring.rig_report import LATE_MS, AffectedFrame, BoardScore
from vaoi_station.rig.scoring.ring_check import RingCheck

Cell = tuple[int, int]
"""A frame, as (camera, row)."""
RUN_MATCH_S = 0.5
"""Largest difference between the barrier edge of a run and that of a passage, if the run is of that passage."""
IN_FLIGHT_S = 0.2
"""Longest time from a pulse to the last packet of its frames, s.

An outage that begins within this time after a pulse may still lose frames of the pulse."""
_EXPOSED_SHARE = 0.02
"""Largest difference of a stated exposure from the real one, as a share of it."""
_OUTCOME_TEXTS: dict[FrameOutcome, str] = {
    "ignored": "the camera ignored the pulse",
    "hit": "packets were lost",
    "lost": "all packets were lost",
    "dead": "the camera was dead",
}


@dataclass(frozen=True)
class Outage:
    """A period in which frames of one camera, or of all cameras, may be lost because of an injected fault."""

    from_ns: int
    until_ns: int
    camera: int | None
    """Number of the camera; None: all cameras."""
    reason: str

    def covers(self, fired_ns: int, camera: int) -> bool:
        """Return whether this outage may have lost a frame of a camera, fired at `fired_ns` of CLOCK_MONOTONIC."""
        flight_ns = round(IN_FLIGHT_S * 1e9)
        return self.camera in (None, camera) and self.from_ns - flight_ns <= fired_ns <= self.until_ns


@dataclass(frozen=True)
class BoardEvidence:
    """Everything that the score of one board needs: its passage on the rig, and the station's run of it."""

    passage: BoardPassage
    run: dict[str, Any] | None
    """JSON of `runs/{id}`; None: the station has no run of the board."""
    matrices: dict[str, Any]
    ring_check: RingCheck | None
    """Comparison of the ring with the rendered frames; None: not done."""
    px_per_mm: Sequence[float]
    armed_id: str | None = None
    """Board id with which the station was armed for this board; None if it was not armed for it."""
    lighting: Lighting | None = None
    """The lights and the program of the rig; None: what frames were taken with is not compared."""


def score(evidence: BoardEvidence, outages: Sequence[Outage]) -> BoardScore:
    """Compare the run of one board with truth, rendered frames and injected faults. Return the score."""
    passage, run, check = evidence.passage, evidence.run, evidence.ring_check
    verdicts = _station_verdicts(run)
    reasons = _reasons(passage, outages)
    whole = {cell for cell, (verdict, _) in verdicts.items() if verdict == "ok"}
    affected = [
        _affected_frame(cell, verdicts[cell], reasons.get(cell, "")) for cell in sorted(verdicts) if cell not in whole
    ]
    found = compare_with_truth(
        passage.rendered.metadata.views, evidence.matrices.get("components") or {}, evidence.px_per_mm
    )
    counts = {word: sum(v == word for v, _ in verdicts.values()) for word in ("ok", "incomplete", "missing")}
    wrong = dict(check.wrong) if check else {}
    timings = (run or {}).get("timings") or {}
    return BoardScore(
        board=passage.board,
        run=run["id"] if run else None,
        state=run["state"] if run else None,
        status=run["verdict"] if run else None,
        armed_id=evidence.armed_id,
        board_id=(run or {}).get("board_id"),
        reasons=tuple(reason["message"] for reason in run["reasons"]) if run else (),
        cameras=passage.rendered.metadata.cameras,
        rows=len(passage.fired),
        rows_due=passage.rendered.rows,
        ok=counts["ok"],
        incomplete=counts["incomplete"],
        missing=counts["missing"],
        proven=len(check.proven & whole) if check and check.valid else None,
        wrong=tuple(f"camera {c}, row {r}: {text}" for (c, r), text in sorted(wrong.items())),
        mislit=tuple(_mislit(passage, run, evidence.lighting)),
        affected=tuple(affected),
        innocent=tuple(cell for cell in sorted(verdicts) if cell not in whole and cell not in reasons),
        unnamed=tuple(cell for cell, (verdict, cause) in sorted(verdicts.items()) if verdict != "ok" and not cause),
        unfilmed=_unfilmed(passage, verdicts),
        pulse_off_us=max((abs(f.offset_us) for f in passage.fired if f.row is not None), default=0.0),
        sent_late_ms=_sent_late_ms(passage),
        notes=tuple(dict.fromkeys(f.note for f in passage.fired if f.note)),
        deviation=found,
        ready_after_last_frame_ms=timings.get("ready_after_last_frame_ms"),
        held_s=None if passage.held_s is None else round(passage.held_s, 3),
        links_open=timings["links"] - timings["links_while_filming"] if timings else None,
    )


def run_of(passage: BoardPassage, runs: Sequence[Mapping[str, Any]], started_s: Mapping[str, float]) -> str | None:
    """Return the id of the run whose barrier edge is nearest to that of a passage; None: none is near enough.

    Args:
        passage: the passage of one board.
        runs: JSON of all runs.
        started_s: run id → time of the run's barrier edge, s of CLOCK_MONOTONIC.
    """
    blocked_s = passage.blocked_ns * 1e-9
    near = [(abs(started_s[run["id"]] - blocked_s), run["id"]) for run in runs]
    distance_s, run = min(near, default=(float("inf"), None))
    return run if distance_s <= RUN_MATCH_S else None


def _station_verdicts(run: Mapping[str, Any] | None) -> dict[Cell, tuple[str, str]]:
    """Return (camera, row) → (verdict, cause), as the station reports them for each frame of a run."""
    frames = run["frames"] if run else ()
    return {(f["camera"], f["row"]): (f["verdict"], f.get("cause") or "") for f in frames}


def _reasons(passage: BoardPassage, outages: Sequence[Outage]) -> dict[Cell, str]:
    """Return {(camera, row): text of the fault} for frames whose loss an injected fault may have caused."""
    reasons = {}
    for row, fired in enumerate(passage.fired):
        for camera, outcome in enumerate(fired.outcomes):
            causes = [t.reason for t in outages if t.covers(fired.pulse.host_ns, camera)]
            sent_ms = fired.sent_ms.get(camera, math.inf)
            # A fault of this frame comes before an outage, because it is the more specific cause.
            if outcome in _OUTCOME_TEXTS:
                reasons[camera, row] = _OUTCOME_TEXTS[outcome]
            elif causes:
                unarmed = ", and the camera was not armed" if outcome == "unarmed" else ""
                reasons[camera, row] = f"{causes[0]}{unarmed}"
            elif outcome == "sent" and sent_ms > LATE_MS:
                late = f"sent it {sent_ms:.0f} ms late" if math.isfinite(sent_ms) else "never sent it"
                reasons[camera, row] = f"the rig {late}"
    return reasons


def _sent_late_ms(passage: BoardPassage) -> float | None:
    """Return the longest delay, ms, with which a frame was sent; None if a frame without packet loss was never sent."""
    late = [
        fired.sent_ms.get(n) for fired in passage.fired for n, outcome in enumerate(fired.outcomes) if outcome == "sent"
    ]
    known = [ms for ms in late if ms is not None]
    return round(max(known, default=0.0), 1) if len(known) == len(late) else None


def _affected_frame(cell: Cell, verdicts: tuple[str, str], done: str) -> AffectedFrame:
    verdict, cause = verdicts
    return AffectedFrame(camera=cell[0], row=cell[1], verdict=verdict, cause=cause, done=done)


def _mislit(passage: BoardPassage, run: Mapping[str, Any] | None, lighting: Lighting | None) -> Iterator[str]:
    """Yield a text for each complete frame whose light or exposure the station states otherwise than the chip fired it.

    The chip's pulses are those of its pins: which LEDs were on, and for how long.
    """
    for frame in run["frames"] if run and lighting else ():
        camera, row = frame["camera"], frame["row"]
        if frame["verdict"] != "ok" or row >= len(passage.fired):
            continue
        assert lighting is not None, "there are no frames without it"
        pulse = passage.fired[row].pulse
        light, exposure_us = lighting.light_of(pulse), lighting.exposure_us(pulse, camera, row)
        stated, stated_us = frame.get("light"), frame.get("exposure_us")
        if stated != light:
            yield f"camera {camera}, row {row}: the station states the light {stated!r}, lit was {light!r}"
        if stated_us is None or abs(stated_us - exposure_us) > _EXPOSED_SHARE * exposure_us:
            yield f"camera {camera}, row {row}: the station states {stated_us} µs of light, it was {exposure_us:.1f} µs"


def _unfilmed(passage: BoardPassage, verdicts: Mapping[Cell, object]) -> int:
    """Return the number of fired frames that the station's run does not list."""
    cells = {(c, r) for r in range(len(passage.fired)) for c in range(passage.rendered.metadata.cameras)}
    return len(cells - set(verdicts))
