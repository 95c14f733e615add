"""One board of two runs: its top and its bottom, joined by the id of the board and the time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import Literal

import numpy as np
from pydantic import Field

from vaoi_station.errors import NotFoundError, VaoiError
from vaoi_station.model import Reason, Status, Strict
from vaoi_station.runs.archive.finished_runs import FinishedRun
from vaoi_station.runs.kept_runs import KeptRuns
from vaoi_station.runs.states.schemas import RunSummary
from vaoi_station.store.run_search import RunFilter

SideName = Literal["top", "bottom"]
_MOST_RUNS = 20
"""Runs of one id that are read, the newest first."""
_SAME_MM, _SQUARE_DEG = 1.0, 10.0
"""Sides of one board have outlines that differ by less, and are flipped about an axis that is so near to x or y."""


class BoardSide(Strict):
    """The run that shows one side of a board."""

    side: SideName
    run: str
    address: str = Field(description="Of the run; `parts`, `components` and pictures are below it.")
    board_type: str
    started: str
    verdict: Status | None = Field(default=None, description="Absent while the run is stitched, or without a result.")
    identity: str | None = Field(default=None, description="State of its identity, if the board type has codes.")
    components: int
    extent_mm: tuple[tuple[float, float], tuple[float, float]] = Field(
        description="Lowest and highest corner of the board, CAD coordinates of the top view, mm."
    )
    cad_matrix: tuple[tuple[float, float, float], ...] | None = Field(default=None, description="C of the run.")


class BoardDocument(Strict):
    """A board with both sides. CAD coordinates are those of the top view on both, so that parts have one frame."""

    board_id: str
    status: Status = Field(description="ok: both sides are there, are ok and agree.")
    reasons: tuple[Reason, ...] = ()
    top: BoardSide | None = None
    bottom: BoardSide | None = None
    flip_axis_deg: float | None = Field(
        default=None, description="Axis about which the board was flipped from top to bottom, tester coordinates."
    )


def sides_of(board_id: str, kept: KeptRuns, finished: Callable[[str], FinishedRun], prefix: str) -> list[BoardSide]:
    """Return the runs of a board, newest first, by the id that was armed, read or reported.

    `prefix` is the address of all runs. Raise NotFoundError if there is none.
    """
    by_order, _ = kept.history.find(RunFilter(board_id=board_id), _MOST_RUNS, None)
    by_code, _ = kept.with_id(board_id, RunFilter(), _MOST_RUNS, None)
    runs: dict[str, RunSummary] = {run.id: run for run in (*by_order, *by_code)}
    out = []
    for run in sorted(runs.values(), key=lambda r: r.started, reverse=True):
        try:
            known = finished(run.id)
        except VaoiError:  # It is still under way, or was forgotten meanwhile.
            continue
        board, stitch, mm = known.board_type, known.stitch, known.board_type.mm_per_unit
        up = np.array([mm, mm if board.y_axis == "up" else -mm])
        corners = np.sort(np.array(board.extent()) * up, axis=0).round(4).tolist()
        matrix = None
        if stitch is not None and stitch.cad_matrix is not None:
            # From mm with y up, as the extent: the two sides may be of different units and axes.
            matrix = tuple(map(tuple, (np.asarray(stitch.cad_matrix) @ np.diag([*(1 / up), 1.0])).tolist()))
        identity = known.identity
        out.append(
            BoardSide(
                side=board.side,
                run=run.id,
                address=f"{prefix}/{run.id}",
                board_type=board.name,
                started=run.started,
                verdict=known.detail.verdict,
                identity=None if identity is None else identity.state,
                components=len(board.components),
                extent_mm=tuple(map(tuple, corners)),
                cad_matrix=matrix,
            )
        )
    if not out:
        raise NotFoundError(
            f"No finished run shows a board with the id {board_id!r}.",
            action="Check the id; runs?board_id= and runs?read_id= search for it.",
            code="unknown-board",
        )
    return out


def join_sides(board_id: str, sides: Sequence[BoardSide], within_s: float) -> BoardDocument:
    """Join the newest run of each side; what is missing or contradicts is among the reasons."""
    newest = max(_time(s) for s in sides)
    recent = sorted((s for s in sides if newest - _time(s) <= within_s), key=_time)
    found = {s.side: s for s in recent}
    top, bottom, reasons = found.get("top"), found.get("bottom"), list[Reason]()
    if top is None or bottom is None:
        missing = "top" if top is None else "bottom"
        message = f"no run within {within_s:g} s of the other side shows the {missing}"
        reasons.append(
            Reason(code="side-missing", message=message, action="Film it, ask its station, or ask for a longer time.")
        )
    for side in found.values():
        if side.verdict is not Status.OK:
            message = f"the {side.side}, run {side.run}, is {side.verdict or 'without a result'}"
            reasons.append(Reason(code="side-not-ok", message=message, action="See the reasons of the run."))
        if side.identity == "differs":
            message = f"the codes of the {side.side}, run {side.run}, state another id"
            reasons.append(Reason(code="side-of-other-board", message=message, action="Identify the board."))
    flip = None
    if top is not None and bottom is not None:
        apart = float(np.abs(np.ptp(top.extent_mm, axis=0) - np.ptp(bottom.extent_mm, axis=0)).max())
        if apart > _SAME_MM:
            message = f"the outlines of {top.board_type!r} and {bottom.board_type!r} differ by {apart:.1f} mm"
            reasons.append(
                Reason(code="sides-differ", message=message, action="Check that both board types are of one product.")
            )
        flip = _flip(top, bottom, reasons)
    worst = Status.FAILED if any(s.verdict is Status.FAILED for s in found.values()) else Status.DEGRADED
    status = worst if reasons else Status.OK
    return BoardDocument(
        board_id=board_id, status=status, reasons=tuple(reasons), top=top, bottom=bottom, flip_axis_deg=flip
    )


def _flip(top: BoardSide, bottom: BoardSide, reasons: list[Reason]) -> float | None:
    """Return the axis of the flip, degrees from 0 to 180; None if it is not known."""
    if top.cad_matrix is None or bottom.cad_matrix is None:
        return None
    (a, _), (b, _) = change = np.array(bottom.cad_matrix)[:2, :2] @ np.linalg.inv(np.array(top.cad_matrix)[:2, :2])
    if np.linalg.det(change) > 0:
        message = "both runs see the board from the same side, or their tester coordinates differ in handedness"
        reasons.append(
            Reason(code="sides-not-flipped", message=message, action="Check the key `side` of both board types.")
        )
        return None
    axis = math.degrees(math.atan2(b, a)) / 2 % 180
    if abs((axis + 45) % 90 - 45) > _SQUARE_DEG:
        message = f"the board was flipped about an axis at {axis:.1f}°, neither along x nor along y"
        reasons.append(
            Reason(code="sides-not-flipped", message=message, action="Check that both runs are of one board.")
        )
    return round(axis, 3)


def _time(side: BoardSide) -> float:
    return datetime.fromisoformat(side.started).timestamp()
