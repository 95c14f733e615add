"""Reasons of a verdict that concern single boards of a panel: which fiducials do not place them, and what follows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from vaoi_station.model import Reason, ReasonCode
from vaoi_station.stitching.components.bad_board_marks import BoardMarks, MarkReading
from vaoi_station.stitching.components.panel_boards import BoardPlace

_LIMIT_PX = 0.3
"""Largest accepted distance of a fiducial from the place that shift and turn of its board give it."""
_MOST_NAMED = 4


def board_reasons(places: Mapping[str, BoardPlace], px_per_mm: float, *, searched: bool = True) -> Iterator[Reason]:
    """Yield the reasons for boards of a panel that their fiducials do not place, or not well.

    Args:
        places: the boards' places, by position.
        px_per_mm: resolution of the station.
        searched: whether the method of the run uses fiducials.
    """
    check = "check these fiducials on the board and in the CAD data"
    if not searched:
        check = "the method of this run uses no fiducials: stitch it with the method auto, features or fiducials"
    refused = [f"{at}: {place.refusal}" for at, place in places.items() if place.refusal]
    if refused:
        sigma = max(place.sigma_mm for place in places.values() if place.refusal)
        yield Reason(
            ReasonCode.BOARD_UNPLACED,
            f"{len(refused)} of {len(places)} boards of the panel follow the panel, with ± {sigma:.2f} mm, because "
            f"their fiducials do not place them ({_named(refused)}): {check}",
        )
    alone = [
        f"{at}: {place.fiducials[0]}" for at, place in places.items() if not place.refusal and len(place.fiducials) == 1
    ]
    if alone:
        yield Reason(
            ReasonCode.BOARD_UNPLACED,
            f"one fiducial alone places {len(alone)} of {len(places)} boards of the panel, so that their turn is not "
            f"known ({_named(alone)}): {check}, or give the board type two fiducials of each board",
        )
    for at, place in places.items():
        off_px = place.off_mm * px_per_mm
        if not place.refusal and off_px > _LIMIT_PX:
            yield Reason(
                ReasonCode.FIDUCIAL_OFF_PLACE,
                f"fiducials {', '.join(place.fiducials)} of board {at} of the panel lie up to {off_px:.2f} px from "
                f"their places on it (limit {_LIMIT_PX}): {check}",
            )


def mark_reasons(boards: Mapping[str, BoardMarks]) -> Iterator[Reason]:
    """Yield a reason for each board of a panel whose bad-board marks are doubtful; `boards` by position."""
    for at, board in boards.items():
        if board.state != "doubtful":
            continue
        doubtful = [mark for mark in board.marks if mark.state == "doubtful"]
        shown = "; ".join(map(_seen, doubtful)) or "its marks contradict one another"
        yield Reason(
            ReasonCode.BAD_BOARD_DOUBTFUL,
            f"it is not clear whether board {at} of the panel is crossed out, so it is not skipped: {shown}. Inspect "
            "the mark on the board, mark or clean it, and compare `good` and `bad` of the mark in the board type",
        )


def _seen(mark: MarkReading) -> str:
    good, bad = mark.expected
    where = f"mark {mark.name} at CAD ({mark.cad[0]:g}, {mark.cad[1]:g})"
    if mark.place is not None:
        camera, row, x, y = mark.place
        where += f", camera {camera} row {row} at ({x:.0f}, {y:.0f}) px,"
    if not mark.frames:
        return f"{where} is in no frame that shows it completely, large and bright enough"
    shares = ", ".join(f"{share:.0%} {look}" for look, share in mark.shares.items())
    return f"{where} is {shares} (80 % must be {good} on a good board, {bad} on a bad one)"


def _named(boards: list[str]) -> str:
    more = f"; and {len(boards) - _MOST_NAMED} more" if len(boards) > _MOST_NAMED else ""
    return "; ".join(boards[:_MOST_NAMED]) + more
