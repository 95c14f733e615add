"""The measures of all parts of a run as one document, with what cannot be said and why."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np

from vaoi_station.model import BoardType, Component, Status
from vaoi_station.model.part_limits import beyond
from vaoi_station.parts import probability
from vaoi_station.parts.learned import TaughtBoard, parts_digest
from vaoi_station.parts.measure import Evidence, Run, SoFar, collect
from vaoi_station.parts.models import STRANGE, VISIBLE, Models, is_chip
from vaoi_station.parts.patches import RunPatches, same_class
from vaoi_station.steps import Steps

FORMAT, VERSION = "vaoi-parts", 1
_AT_ONCE = 400
"""Number of parts that are measured at once, which bounds the memory."""
_PRESENT = 0.5
"""Probability of presence from which on place and orientation are stated."""
_SURE = (0.2, 0.8)
"""Without good boards, a probability between these is not stated."""
_PLACED = 9.0
"""How unlike good ones a part may look whose place is stated."""
_ALIKE = 0.5
_LEAST_SAMPLES = 3
"""Least number of taught parts of a kind of which one can look otherwise than the others."""
_DARK_SHARE = 0.5
"""Share of parts that a light shows black or saturated from which on its lamp is in doubt."""
_OTHER_REVISION, _LEAST_UNLIKE = 0.5, 8
"""Share of parts that are unlike, and their number, from which on a board is another revision and not a bad one."""
REASONS = {
    "unseen": "no frame shows the whole part",
    "dark": "the part is saturated or black in all frames",
    "untaught": "no good board has this part",
    "light-untaught": "no good board was filmed under this light and exposure",
    "undecided": "frames alone do not tell whether it is there; teach a good board",
    "not-found": "the part is not where it belongs, or looks otherwise than good ones, so its place is not known",
    "no-marks": "the part looks alike either way round",
}
_FEW_BOARDS = 3
"""Number of good boards from which on it shows which of them is unlike the others."""
REMARKS = {
    "run-not-ok": "the run is {status}: its reasons hold for the measures of its parts, too.",
    "own-board": "this board is one of the good boards, so that its own faults are not seen.",
    "few-good-boards": "good boards: {count}. How far good parts differ is hardly known from fewer than {least}, so "
    "that more good parts look unlike; places hold. Teach further boards.",
    "good-board-unusable": "{why}",
    "good-board-of-other-type": "{boards}: most parts are not those of this board type, so that they are left out. "
    "Remove them from its good boards.",
    "board-type-changed": "the board type has changed since {boards} became good boards: parts of the same package and "
    "size are compared, others are not. Teach a board again.",
    "calibration-differs": "the calibration differs from that of {boards}: presence, orientation and likeness hold; "
    "places hold as far as both calibrations are right.",
    "other-lights": "no good board was filmed under the light {lights}: only other lights are compared.",
    "dark-lights": "under the light {lights} most parts are black or saturated: only other lights are compared. Check "
    "the lamp and its exposure.",
    "other-revision": "{unlike} of {said} parts are unlike those of good boards: this is a board of another revision "
    "or type. Check which product passes, or teach good boards of this revision.",
}
"""What limits the measures of a run, by code: sentences in which values are put."""


class Remark(NamedTuple):
    """What limits the measures of a run: a code of `REMARKS`, and the values for its sentence."""

    code: str
    values: dict[str, Any]

    def __str__(self) -> str:
        texts = {k: ", ".join(v) if isinstance(v, list) else v for k, v in self.values.items()}
        return REMARKS[self.code].format_map(texts)


def measure_parts(
    run: Run, models: Models, parts: Sequence[Component] | None = None, so_far: SoFar | None = None
) -> dict[str, dict[str, Any]]:
    """Measure parts of a run, by address; all of its board type if `parts` is None.

    `so_far` is shared by the calls for one run, so that later ones know how bright its good parts are.
    """
    every = run.board_type.components if parts is None else parts
    so_far = SoFar() if so_far is None else so_far
    found: dict[str, dict[str, Any]] = {}
    for begin in range(0, len(every), _AT_ONCE):
        found |= describe(*collect(run, models, every[begin : begin + _AT_ONCE], so_far), models.addresses)
    return found


def describe(patches: RunPatches, evidence: Evidence, known: Collection[str] = ()) -> dict[str, dict[str, Any]]:
    """Return the measures of n parts by address, as they stand in documents; `known` are the parts of good boards."""
    e = evidence
    taught = e.boards > 0
    measured, sigma = np.column_stack([e.lift, e.wide]), np.column_stack([e.lift_sigma, e.wide_sigma])
    heights = probability.height_evidence(measured, sigma, e.lifts)
    presence = np.where(
        taught,
        probability.presence(e.unlike, e.other, heights),
        probability.presence_by_height(heights),
    )
    alike = probability.alike(e.unlike)
    turns = probability.orientation(e.ratio, e.marks, math.log(VISIBLE))
    place_sigma, turn_sigma = probability.sigmas(e.noise_mm, e.noise_deg, scale_of(patches, e))
    out = {}
    for k, part in enumerate(patches.parts):
        found: dict[str, Any] = dict.fromkeys(
            ("presence", "dx_mm", "dy_mm", "sigma_mm", "turn_deg", "sigma_deg", "orientation", "alike", "height_mm")
        )
        reasons: list[str] = []
        out[part.address] = found | {
            "frames": int(e.frames[k]), "boards": int(e.boards[k]), "reasons": reasons
        }  # fmt: skip
        found = out[part.address]
        if not e.frames[k] or patches.dark[k]:
            reasons.append("dark" if e.frames[k] else "unseen")
            continue
        if np.isfinite(e.lift[k]):
            found["height_mm"] = round(float(e.lift[k] * patches.height_mm[k]), 3)
        p = float(presence[k])
        if not taught[k]:
            reasons.append("light-untaught" if part.address in known else "untaught")
            # Of a part with leads, the footprint shows the bare board as well.
            told = p >= _SURE[1] or (p <= _SURE[0] and is_chip(patches.grids[patches.grid[k]]))
            if np.abs(heights[k]).sum() < probability.FAINT or not told:
                reasons.append("undecided")
            else:
                found["presence"] = round(p, 4)
            continue
        found["presence"], found["alike"] = round(p, 4), round(float(alike[k]), 4)
        if p < _PRESENT:
            continue
        if e.unlike[k] > _PLACED:
            reasons.append("not-found")
            continue
        quarters = int(e.quarters[k])
        turn = (float(e.turn_deg[k]) + 90 * quarters + 180) % 360 - 180
        found |= {
            "dx_mm": round(float(e.place_mm[k, 0]), 4), "dy_mm": round(float(e.place_mm[k, 1]), 4),
            "sigma_mm": round(float(place_sigma[k]), 4), "turn_deg": round(turn, 3),
            "sigma_deg": round(float(turn_sigma[k]), 3),
        }  # fmt: skip
        # A square part may be known not to lie crosswise; without its marks, pin 1 may still be on either side.
        if turns[k, 2] > 0:
            found["orientation"] = {
                str(90 * q): round(float(turns[k, q]), 4) for q in range(4) if q == 0 or turns[k, q] > 0
            }
        else:
            reasons.append("no-marks")
        out[part.address] = found
    return out


def scale_of(patches: RunPatches, e: Evidence) -> probability.Scale:
    """Return what the standard deviations of the places and turns of parts depend on."""
    grids = [patches.grids[g] for g in patches.grid]
    return probability.Scale(
        np.array([g.px_per_mm for g in grids]), np.array([max(g.body_px) for g in grids]), e.samples, e.unlike,
        e.searched, np.hypot(*e.place_mm.T), e.turn_deg,
    )  # fmt: skip


def parts_document(
    run: Run, models: Models, parts: dict[str, dict[str, Any]], doubts: Sequence[Remark]
) -> dict[str, Any]:
    """Return the document of a run: measures, with those beyond limits marked, good boards, and doubts."""
    _mark(run.board_type, parts)
    said = [p for p in parts.values() if p["alike"] is not None]
    unlike = sum(p["alike"] < _ALIKE for p in said)
    remarks = [*doubts]
    if unlike >= _LEAST_UNLIKE and unlike > _OTHER_REVISION * len(said):
        remarks.append(Remark("other-revision", {"unlike": unlike, "said": len(said)}))
    return {
        "format": FORMAT, "version": VERSION, "board_type": run.board_type.name,
        "good_boards": [b.name for b in models.boards], "remarks": [str(r) for r in remarks],
        "remark_codes": [r.code for r in remarks], "remark_values": [r.values for r in remarks], "parts": parts,
        "reason_texts": {c: REASONS[c] for c in sorted({c for p in parts.values() for c in p["reasons"]})},
    }  # fmt: skip


def _mark(board_type: BoardType, parts: dict[str, dict[str, Any]]) -> None:
    """Name in each part the measures that are beyond the limits of its board type."""
    if board_type.limits is not None:
        limits = board_type.limits.by_part({c.address: c.package for c in board_type.components})
        for address in limits.keys() & parts.keys():
            if marked := beyond(limits[address], parts[address]):
                parts[address]["marked"] = marked


def disagreement_steps(boards: Sequence[TaughtBoard]) -> Steps[list[dict[str, Any]]]:
    """Return the parts of good boards that look unlike others of their kind: board, part and unlikeness.

    Each step compares the parts of one kind. Of two boards it does not show which one is right, and a part of another
    make or lettering looks as unlike: there are no such parts then.
    """
    if len(boards) < _FEW_BOARDS:
        return []
    found: dict[tuple[str, str], float] = {}
    models = Models(boards)
    for grid, view in sorted({(g, c) for b in boards for g in b.grids for c in b.classes}):
        for kind in models.kinds(grid, view)[:1]:
            if len(kind.of) < _LEAST_SAMPLES:
                continue
            unlike = kind.unlikeness(kind.fit, kind.gain)
            usual = {a for v in models.kinds(grid, view)[1:] for a in v.addresses or ()}
            for key, value in zip(kind.of, unlike.tolist(), strict=True):
                if value > STRANGE and key[1] not in usual:
                    found[key] = max(value, found.get(key, 0.0))
        yield
    return [{"board": b, "part": a, "unlike": round(u, 1)} for (b, a), u in sorted(found.items())]


def dark_lights(so_far: SoFar) -> list[Remark]:
    """Return a remark if the pictures of most parts under a light say nothing."""
    dark = [light or "no name" for light, shown in so_far.shown.items() if so_far.blank[light] > _DARK_SHARE * shown]
    return [Remark("dark-lights", {"lights": sorted(dark)})] if dark else []


def changes(run: Run, boards: Sequence[TaughtBoard], calibration: str, name: str = "") -> list[Remark]:
    """Return what limits the measures of a run: its own doubts, and what has changed since boards were taught.

    `name` is that of the run among good boards.
    """
    out = []
    if run.stitch.status is not Status.OK:
        out.append(Remark("run-not-ok", {"status": run.stitch.status.value}))
    if 0 < len(boards) < _FEW_BOARDS:
        out.append(Remark("few-good-boards", {"count": len(boards), "least": _FEW_BOARDS}))
    if name in {b.name for b in boards}:
        out.append(Remark("own-board", {}))
    digest = parts_digest(run.board_type)
    if other := [b.name for b in boards if b.board_type != digest]:
        out.append(Remark("board-type-changed", {"boards": other}))
    if other := [b.name for b in boards if b.calibration != calibration]:
        out.append(Remark("calibration-differs", {"boards": other}))
    missing = [c for c in run.classes() if not any(same_class(c, d) for b in boards for d in b.classes)]
    if boards and missing:
        lights = [f"{c.light or 'no name'} at {c.exposure:g} µs" for c in missing]
        out.append(Remark("other-lights", {"lights": lights}))
    return out
