"""Reasons for rows that links do not connect well: there are none, they repeat, they disagree, or they scatter."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from vaoi_station.model import Reason, ReasonCode
from vaoi_station.stitching.adjustment.observations import Ints, median_noise_px
from vaoi_station.stitching.adjustment.problem import Influence
from vaoi_station.stitching.quality.findings import Findings

_FLOOR_LIMIT_PX, _UNEXPLAINED_PX, _UNEXPLAINED = 0.30, 0.15, 3.0
"""Largest scatter of links beyond image noise: in any case, and if it exceeds the image noise by the last factor.

Scatter that noise does not explain comes from links that do not move with the board, for example on a belt as bright as
the board (seed 108935). Of 3191 drawings that were `ok`, no other one had more than 0.15 px and three times the noise.
"""
_USED = 0.1
"""Weight above which a link counts as used."""


def unconnected_rows(f: Findings) -> Iterator[Reason]:
    """Yield a reason for rows that no links connect with the others."""
    if f.unplaced:
        yield from _unplaced_rows(f)
        return
    groups = _groups_of_rows(f)
    if len(groups) < 2:
        return
    parts = ", ".join(f"{g.min()}–{g.max()}" for g in groups)
    unlinked = f"no links connect the rows {parts} with one another: the belt's nominal speed gives their distance"
    ends = [(int(a.max()), int(b.min())) for a, b in pairwise(groups)]
    lost = [row for last, first in ends for row in range(last + 1, first) if not f.placed[row]]
    if not lost:
        yield Reason(ReasonCode.ROWS_NOT_CONNECTED, unlinked)
        return
    yield Reason(
        ReasonCode.ROWS_LOST,
        f"no camera delivered a good frame of row{'s' if len(lost) > 1 else ''} {', '.join(map(str, lost))}, and "
        f"{unlinked}. Fiducials on both sides of the gap may not fit together for that reason: repair what lost these "
        "frames and film the board again",
    )


def _groups_of_rows(f: Findings) -> list[Ints]:
    """Return the groups of rows between which there is no connection by links or marks."""
    if len(f.connected_groups) > 1:
        return f.connected_groups
    # A single row without links to other rows is in no group.
    o, points = f.problem.links, f.problem.fiducials
    seen, placed = np.append(o.p, o.q), np.flatnonzero(f.placed)
    marked = points.row if points is not None else np.zeros(0, dtype=np.int_)
    for last, first in pairwise(placed.tolist()):
        sides = [((rows <= last).any(), (rows >= first).any()) for rows in (seen, marked)]
        spanned = ((o.p <= last) & (o.q >= first) | (o.q <= last) & (o.p >= first)).any()
        if first > last + 1 and not spanned and all(sides[0]) and not all(sides[1]):
            return [placed[placed <= last], placed[placed >= first]]
    return f.connected_groups


def _unplaced_rows(f: Findings) -> Iterator[Reason]:
    """Yield a reason for the rows without known position; rows at the board's ends that hardly show it do not count."""
    if not f.unseen and not any(set(f.unplaced) & set(g.tolist()) for g in f.connected_groups):
        return
    rows = ", ".join(f"{a}" if a == b else f"{a}–{b}" for a, b in _ranges(f.unplaced))
    unlinked = (
        f"no links connect the rows {rows} with the rows in which the board is placed: how far the belt moved "
        "in between is not known, and these rows have no matrices and no views"
    )
    lost = [row for row, placed in enumerate(f.placed) if not placed and row not in f.unplaced]
    if not lost:
        yield Reason(ReasonCode.ROWS_NOT_CONNECTED, f"{unlinked}. Check the belt, and film the board again")
        return
    yield Reason(
        ReasonCode.ROWS_LOST,
        f"no camera delivered a good frame of row{'s' if len(lost) > 1 else ''} {', '.join(map(str, lost))}, and "
        f"{unlinked}: repair what lost these frames and film the board again",
    )


def _ranges(rows: tuple[int, ...]) -> list[tuple[int, int]]:
    """Return the first and the last row of each group of consecutive rows."""
    ends = [(a, b) for a, b in pairwise(rows) if b > a + 1]
    return list(zip((rows[0], *(b for _, b in ends)), (*(a for a, _ in ends), rows[-1]), strict=True))


def rows_apart(f: Findings) -> list[list[int]]:
    """Return the groups of rows whose distance from the other rows is uncertain by periods of a repeated pattern.

    A group that shows a fiducial is certain: a motion that is wrong by a period would displace that fiducial. If no
    row shows one, all groups are returned.
    """
    cuts = {(e.task.a[1], e.task.b[1]) for e in f.links if e.ambiguous and e.task.b is not None}
    rows = sorted({row for _, row in f.scene.present})
    if not cuts & set(pairwise(rows)):
        return []
    points = f.problem.fiducials
    marked = set(points.row.tolist()) if points is not None else set()
    groups = [[rows[0]]]
    for p, q in pairwise(rows):
        if (p, q) in cuts:
            groups.append([])
        groups[-1].append(q)
    return [group for group in groups if not marked & set(group)]


def repeated_rows(f: Findings) -> Iterator[Reason]:
    """Yield a reason for rows whose motion against the others a repeated pattern leaves open and no mark confirms."""
    unsure = [row for group in rows_apart(f) for row in group]
    if unsure:
        named = ", ".join(f"{a}" if a == b else f"{a}–{b}" for a, b in _ranges(tuple(unsure)))
        yield Reason(
            ReasonCode.ROWS_REPETITIVE,
            f"a repeated pattern connects the rows {named} with the others at several motions of the belt, and no "
            "fiducial in these rows decides between them: the motion nearest to the nominal speed is used; use a "
            "reference, or fiducials that every row shows",
        )


def scattered_links(f: Findings) -> Iterator[Reason]:
    """Yield a reason if the links between rows scatter by more than noise explains."""
    links, floor = f.problem.links, f.adjusted.floor_px
    noise = median_noise_px(links, np.flatnonzero((f.adjusted.weight > _USED) & (links.p != links.q)))
    if floor > _FLOOR_LIMIT_PX:
        scatter = f"links scatter by {floor:.2f} px (limit {_FLOOR_LIMIT_PX})"
        yield Reason(ReasonCode.LINKS_SCATTER, f"{scatter}: the board is not rigid or flat")
    elif floor > max(_UNEXPLAINED_PX, _UNEXPLAINED * noise):
        yield Reason(
            ReasonCode.LINKS_SCATTER,
            f"links scatter by {floor:.2f} px, of which image noise explains {noise:.2f} px (limit {_UNEXPLAINED_PX}): "
            "what the frames show does not move as one board; use a belt or carrier that is darker or brighter than "
            "the board's edge, and check that the board is rigid",
        )


def disputed_positions(f: Findings, limit_px: float) -> str:
    """Return clauses that name what decides positions by more than noise explains; empty if nothing does.

    These are positions that would be known better than `limit_px` if the links of all places, and all marks, agreed.
    """
    influence = f.adjusted.influence
    rows = _uncertain_by(f, influence, limit_px)
    if influence is None or not rows:
        return ""
    of_marks = influence.of_marks
    marks, places = (_uncertain_by(f, influence.select(at), limit_px) for at in (of_marks, ~of_marks))
    clauses = ""
    if marks or not places:
        clauses += (
            "; without one of the marks that place the board (fiducials, fixture, reference) positions move by more "
            "than noise explains: these marks contradict one another. Check whether a mark is dirty or covered, and "
            "compare the marks in the board type with the board"
        )
    if places or not marks:
        named = ", ".join(f"{a}" if a == b else f"{a}–{b}" for a, b in _ranges(tuple(places or rows)))
        clauses += (
            f"; positions in row{'s' if len(places or rows) > 1 else ''} {named} follow from few places of the "
            "pictures, and without one of these they move by more than noise explains: it may show the belt, a shadow, "
            "or a part that the board type lacks. Let consecutive frames overlap more (a slower belt or a shorter "
            "period), and keep belt and carrier darker or brighter than the board's edge"
        )
    return clauses


def _uncertain_by(f: Findings, influence: Influence | None, limit_px: float) -> list[int]:
    """Return the rows with positions that have a standard deviation above a limit only on account of an influence."""
    if influence is None or f.mapping is None:
        return []
    with_it, without = (
        replace(f, found=replace(f.mapping, adjusted=replace(f.adjusted, influence=of))).sigma.rows_px
        for of in (influence, None)
    )
    return [j for j, (px, calm) in enumerate(zip(with_it, without, strict=True)) if px > limit_px >= calm]
