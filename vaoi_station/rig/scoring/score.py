"""One board's run against the twin's truth and against what the rig did to it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from vaoi_station.demo.deviation import deviation
from vaoi_station.rig.line.stage import Fate, Passing
from vaoi_station.rig.scoring.rig_report import LATE_MS, BoardScore, Named
from vaoi_station.rig.scoring.ring_check import Sighting

Cell = tuple[int, int]
"""Camera, row."""
RUN_MATCH_S = 0.5
"""A run is of the board whose barrier edge is no further away."""
IN_FLIGHT_S = 0.2
"""Between a pulse and the last packet of its frames."""
_WORDS: dict[Fate, str] = {
    "ignored": "the camera ignored the pulse",
    "hit": "packets were lost",
    "lost": "all packets were lost",
    "dead": "the camera was dead",
}


@dataclass(frozen=True)
class Trouble:
    """For so long frames of a camera (None: of all) may be lost, for a reason that lies outside their pulses."""

    from_ns: int
    until_ns: int
    camera: int | None
    why: str

    def touches(self, fired_ns: int, camera: int) -> bool:
        """Whether a frame fired at a time of CLOCK_MONOTONIC may be lost by it."""
        flight_ns = round(IN_FLIGHT_S * 1e9)
        return self.camera in (None, camera) and self.from_ns - flight_ns <= fired_ns <= self.until_ns


@dataclass(frozen=True)
class Evidence:
    """What is known of one board."""

    passing: Passing
    run: dict[str, Any] | None
    """JSON of `runs/{id}`; None: there is no run of it."""
    matrices: dict[str, Any]
    sighting: Sighting | None
    """None: its memory was not looked at."""
    px_per_mm: Sequence[float]


def score(evidence: Evidence, troubles: Sequence[Trouble]) -> BoardScore:
    """The verdict on one board."""
    passing, run, seen = evidence.passing, evidence.run, evidence.sighting
    told = _told(run)
    reasons = _reasons(passing, troubles)
    whole = {cell for cell, (verdict, _) in told.items() if verdict == "ok"}
    affected = [_named(cell, told[cell], reasons.get(cell, "")) for cell in sorted(told) if cell not in whole]
    found = deviation(passing.film.sheet.views, evidence.matrices.get("components") or {}, evidence.px_per_mm)
    counts = {word: sum(v == word for v, _ in told.values()) for word in ("ok", "incomplete", "missing")}
    wrong = dict(seen.wrong) if seen else {}
    timings = (run or {}).get("timings") or {}
    return BoardScore(
        board=passing.board,
        run=run["id"] if run else None,
        state=run["state"] if run else None,
        status=run["verdict"] if run else None,
        reasons=tuple(reason["message"] for reason in run["reasons"]) if run else (),
        cameras=passing.film.sheet.cameras,
        rows=len(passing.fired),
        rows_due=passing.film.rows,
        ok=counts["ok"],
        incomplete=counts["incomplete"],
        missing=counts["missing"],
        proven=len(seen.proven & whole) if seen and seen.looked else None,
        wrong=tuple(f"camera {c}, row {r}: {why}" for (c, r), why in sorted(wrong.items())),
        affected=tuple(affected),
        innocent=tuple(cell for cell in sorted(told) if cell not in whole and cell not in reasons),
        unnamed=tuple(cell for cell, (verdict, cause) in sorted(told.items()) if verdict != "ok" and not cause),
        unfilmed=_unfilmed(passing, told),
        pulse_off_us=max((abs(f.off_us) for f in passing.fired if f.row is not None), default=0.0),
        sent_late_ms=_sent_late_ms(passing),
        notes=tuple(dict.fromkeys(f.note for f in passing.fired if f.note)),
        deviation=found,
        ready_after_last_frame_ms=timings.get("ready_after_last_frame_ms"),
        links_open=timings["links"] - timings["links_while_filming"] if timings else None,
    )


def run_of(passing: Passing, runs: Sequence[Mapping[str, Any]], started_s: Mapping[str, float]) -> str | None:
    """The id of the run that was filmed of a board: the one whose barrier edge is the board's.

    Args:
        passing: the board.
        runs: JSON of all runs.
        started_s: run → CLOCK_MONOTONIC of its barrier edge.
    """
    blocked_s = passing.blocked_ns * 1e-9
    near = [(abs(started_s[run["id"]] - blocked_s), run["id"]) for run in runs]
    distance_s, run = min(near, default=(float("inf"), None))
    return run if distance_s <= RUN_MATCH_S else None


def _told(run: Mapping[str, Any] | None) -> dict[Cell, tuple[str, str]]:
    """(camera, row) → verdict and cause, as the station has them."""
    frames = run["frames"] if run else ()
    return {(f["camera"], f["row"]): (f["verdict"], f.get("cause") or "") for f in frames}


def _reasons(passing: Passing, troubles: Sequence[Trouble]) -> dict[Cell, str]:
    """(camera, row) that may be lost → why, by the rig's own account."""
    reasons = {}
    for row, fired in enumerate(passing.fired):
        for camera, fate in enumerate(fired.fates):
            touched = [t.why for t in troubles if t.touches(fired.shot.host_ns, camera)]
            sent_ms = fired.sent_ms.get(camera, math.inf)
            if fate in _WORDS:
                reasons[camera, row] = _WORDS[fate]
            elif touched:
                unarmed = ", and the camera was not armed" if fate == "unarmed" else ""
                reasons[camera, row] = f"{touched[0]}{unarmed}"
            elif fate == "sent" and sent_ms > LATE_MS:
                late = f"sent it {sent_ms:.0f} ms late" if math.isfinite(sent_ms) else "never sent it"
                reasons[camera, row] = f"the rig {late}"
    return reasons


def _sent_late_ms(passing: Passing) -> float | None:
    """The latest of the frames that were sent whole; None: one of them never left."""
    late = [fired.sent_ms.get(n) for fired in passing.fired for n, fate in enumerate(fired.fates) if fate == "sent"]
    known = [ms for ms in late if ms is not None]
    return round(max(known, default=0.0), 1) if len(known) == len(late) else None


def _named(cell: Cell, told: tuple[str, str], done: str) -> Named:
    verdict, cause = told
    return Named(camera=cell[0], row=cell[1], verdict=verdict, cause=cause, done=done)


def _unfilmed(passing: Passing, told: Mapping[Cell, object]) -> int:
    """Frames of pulses that the station says nothing about."""
    cells = {(c, r) for r in range(len(passing.fired)) for c in range(passing.film.sheet.cameras)}
    return len(cells - set(told))
