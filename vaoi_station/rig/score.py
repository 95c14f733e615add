"""Score one board's run against the twin's truth and against the faults that the rig injected."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.ring import EMPTY, NO_ROW, Ring
from vaoi_station.acquisition.ring import OK as WHOLE
from vaoi_station.demo.report import compare_with_truth
from vaoi_station.rig.devices import Outage
from vaoi_station.rig.line import BoardPassage, FrameOutcome, Lighting
from vaoi_station.rig.report import LATE_MS, AffectedFrame, BoardScore
from vaoi_station.rig.virtual_camera import apply_brightness

MONO_8, MONO_16 = 0x01080001, 0x01100007


@dataclass(frozen=True)
class RingCheck:
    """The check of the frames, as (camera, row), in one bay."""

    proven: frozenset[tuple[int, int]]
    """Complete frames of which every pixel equals the frame rendered for that camera and row."""
    wrong: dict[tuple[int, int], str]
    """Frames with other pixels than rendered (or black, in an incomplete frame), with a description."""


def check_bay(ring: Ring, bay: int, passage: BoardPassage) -> RingCheck | None:
    """Compare one bay of the ring with the rendered frames of its board; None if another board got it meanwhile."""
    frames = passage.rendered.map_frames()
    brightness = {fired.row: fired.brightness for fired in passage.fired if fired.row is not None}
    generation = ring.generation(bay)
    proven: set[tuple[int, int]] = set()
    wrong: dict[tuple[int, int], str] = {}
    for camera in range(ring.layout.cameras):
        for k in range(ring.layout.slots_per_camera):
            slot = ring.slot(bay, camera, k)
            _, state, row, _ = ring.slot_record(slot)
            if state == EMPTY or row == NO_ROW:
                continue
            cell = (camera, row)
            shape = ring.layout.frames[camera]
            mono = MONO_8 if shape.nbytes == shape.width * shape.height else MONO_16
            difference = _compare(ring.memory(slot), frames, cell, brightness, mono, whole=state == WHOLE)
            if difference:
                wrong[cell] = difference
            elif state == WHOLE:
                proven.add(cell)
    # The generation of a bay changes when the station gives the bay to the next board, even during this comparison.
    return RingCheck(frozenset(proven), wrong) if ring.generation(bay) == generation else None


def bays_to_check(station: Mapping[str, Any]) -> dict[str, int]:
    """Return run id → bay, for runs whose frames have all arrived. `station` is the JSON of `GET station`."""
    return {
        str(bay["run"]): int(bay["bay"]) for bay in station["ring"]["bays"] if bay["use"] in ("stitching", "finished")
    }


def attach(station: Mapping[str, Any]) -> Ring:
    """Map the station's ring read-only; `station` is the JSON of `GET station`, which has the path of the ring."""
    return Ring.attach(Path(station["ring"]["path"]))


def _compare(
    pixels: NDArray[np.uint8],
    frames: NDArray[np.uint8],
    cell: tuple[int, int],
    brightness: Mapping[int, list[float]],
    mono: int,
    *,
    whole: bool,
) -> str:
    camera, row = cell
    if row not in brightness:
        return "a row that was never fired"
    expected = apply_brightness(frames[row, camera], brightness[row][camera], mono)
    if whole:
        return "" if np.array_equal(pixels, expected) else _identify(pixels, frames, camera, row)
    foreign = (pixels != expected) & (pixels != 0)
    return f"{int(foreign.sum())} pixels of another picture" if foreign.any() else ""


def _identify(pixels: NDArray[np.uint8], frames: NDArray[np.uint8], camera: int, row: int) -> str:
    """Return a text that states which rendered frame of the board has these pixels; empty if none has."""
    for other, of_row in enumerate(frames):
        for place, frame in enumerate(of_row):
            if np.array_equal(pixels, frame):
                return f"it is the frame of camera {place}, row {other}"
    return f"it is no frame of this board as camera {camera} saw it in row {row}"


Cell = tuple[int, int]
RUN_MATCH_S = 0.5
_EXPOSED_SHARE = 0.02
_OUTCOME_TEXTS: dict[FrameOutcome, str] = {
    "ignored": "the camera ignored the pulse",
    "hit": "packets were lost",
    "lost": "all packets were lost",
    "dead": "the camera was dead",
}


@dataclass(frozen=True)
class BoardEvidence:
    """Everything that the score of one board needs: its passage on the rig, and the station's run of it."""

    passage: BoardPassage
    run: dict[str, Any] | None
    """JSON of `runs/{id}`; None: the station has no run of the board."""
    matrices: dict[str, Any]
    ring_check: RingCheck | None
    px_per_mm: Sequence[float]
    armed_id: str | None = None
    """Board id with which the station was armed for this board; None if it was not armed for it."""
    lighting: Lighting | None = None


def score(evidence: BoardEvidence, outages: Sequence[Outage]) -> BoardScore:
    """Compare the run of one board with truth, rendered frames and injected faults. Return the score."""
    passage, run, check = evidence.passage, evidence.run, evidence.ring_check
    cameras = passage.rendered.metadata.cameras
    verdicts = _station_verdicts(run)
    reasons = _reasons(passage, outages)
    whole = {cell for cell, (verdict, _) in verdicts.items() if verdict == "ok"}
    affected = tuple(
        AffectedFrame(camera=c, row=r, verdict=verdict, cause=cause, done=reasons.get((c, r), ""))
        for (c, r), (verdict, cause) in sorted(verdicts.items())
        if verdict != "ok"
    )
    found = compare_with_truth(
        passage.rendered.metadata.views, evidence.matrices.get("components") or {}, evidence.px_per_mm
    )
    counts = {word: sum(v == word for v, _ in verdicts.values()) for word in ("ok", "incomplete", "missing")}
    wrong = dict(check.wrong) if check else {}
    timings = (run or {}).get("timings") or {}
    return BoardScore(
        board=passage.board,
        run=run["id"] if run else None,
        status=run["verdict"] if run else None,
        armed_id=evidence.armed_id,
        board_id=(run or {}).get("board_id"),
        reasons=tuple(reason["message"] for reason in run["reasons"]) if run else (),
        rows=len(passage.fired),
        rows_due=passage.rendered.rows,
        ok=counts["ok"],
        incomplete=counts["incomplete"],
        missing=counts["missing"],
        proven=len(check.proven & whole) if check else None,
        wrong=tuple(f"camera {c}, row {r}: {text}" for (c, r), text in sorted(wrong.items())),
        mislit=tuple(_mislit(passage, run, evidence.lighting)),
        affected=affected,
        unfilmed=len({(c, r) for r in range(len(passage.fired)) for c in range(cameras)} - set(verdicts)),
        pulse_off_us=max((abs(f.offset_us) for f in passage.fired if f.row is not None), default=0.0),
        sent_late_ms=_sent_late_ms(passage),
        notes=tuple(dict.fromkeys(f.note for f in passage.fired if f.note)),
        deviation=found,
        ready_after_last_frame_ms=timings.get("ready_after_last_frame_ms"),
        held_s=None if passage.held_s is None else round(passage.held_s, 3),
        links_open=timings["links"] - timings["links_while_filming"] if timings else None,
    )


def run_of(passage: BoardPassage, runs: Sequence[Mapping[str, Any]], started_s: Mapping[str, float]) -> str | None:
    """Return the id of the run whose barrier edge is nearest to that of a passage; None: none is near enough."""
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


def _mislit(passage: BoardPassage, run: Mapping[str, Any] | None, lighting: Lighting | None) -> Iterator[str]:
    """Yield a text for each complete frame whose light or exposure is stated otherwise than fired."""
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
