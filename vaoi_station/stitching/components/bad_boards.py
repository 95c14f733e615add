"""Single boards of a panel: those that operators and earlier machines cross out, and those that are not placed well.

A bad-board mark looks dark, light or blank (as what surrounds it). The board type states how it looks on good and on
bad boards. A look that is neither, or not clear, leaves the board in doubt: it is tested, and the verdict names it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vaoi_station.frame_index import FootprintViews, FrameIndex
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType, OtherMark, Reason, ReasonCode
from vaoi_station.model.board_type import Look
from vaoi_station.stitching.components.places import OwnPlace

State = Literal["good", "bad", "doubtful"]

_MOST_FRAMES = 4
_LEAST_PX, _LEAST_GREY, _MOST_GREY = 6.0, 8.0, 250.0
"""Smallest diameter of a mark in a frame, and the grey levels between which surroundings can be compared with it."""
_INNER, _RING = 0.4, (0.65, 1.0)
"""Radius of the disc that is read, and radii of the ring that surrounds the mark, as shares of its diameter."""
_CONTRAST, _BLANK = 0.15, 0.08
"""Least contrast (g − r) / (g + r) of a dark or light pixel, and largest one of a blank pixel."""
_LEAST_SHARE = 0.8
"""Least share of the disc's pixels of one look."""
_LIMIT_PX = 0.3
"""Largest accepted distance of a fiducial from the place that shift and turn of its board give it."""
_MOST_NAMED = 4


@dataclass(frozen=True)
class MarkReading:
    """What the frames show of one mark."""

    mark: OtherMark
    state: State
    look: Look | None
    """None if it is not clear, or no frame shows the mark."""
    shares: dict[str, float]
    """Mean share of the mark's disc that looks dark, light and blank."""
    frames: int
    place: tuple[int, int, float, float] | None
    """Camera, row and raw pixels of the mark in the frame that shows it best; None if none shows it."""


@dataclass(frozen=True)
class BoardMarks:
    """The state of one board of a panel, by its marks, which must agree."""

    state: State
    marks: tuple[MarkReading, ...]


def read_bad_marks(board_type: BoardType, of_boards: Mapping[str, Floats], frames: FrameIndex) -> dict[str, BoardMarks]:
    """Read the bad-board marks of all boards of a panel in `frames`; return the boards' states by position."""
    marks = [mark for mark in board_type.other_marks or () if mark.read]
    if not marks:
        return {}
    back = np.linalg.inv(frames.tester_from_cad)
    own = [back @ of_boards.get(str(mark.panel), frames.tester_from_cad) for mark in marks]
    at = np.array([apply(move, np.array([mark.x, mark.y])) for move, mark in zip(own, marks, strict=True)])
    views, found = frames.views(at), dict[str, list[MarkReading]]()
    for n, mark in enumerate(marks):
        reading = _read(mark, n, views, frames, mark.diameter * board_type.mm_per_unit)
        found.setdefault(str(mark.panel), []).append(reading)
    out = {}
    for position, readings in found.items():
        states = {reading.state for reading in readings}
        out[position] = BoardMarks(states.pop() if len(states) == 1 else "doubtful", tuple(readings))
    return out


def _read(mark: OtherMark, number: int, views: FootprintViews, frames: FrameIndex, size_mm: float) -> MarkReading:
    """Read one mark in the frames that show it nearest to their middle; `number` is that of its views."""
    assert frames.prepared is not None
    mine, present = np.flatnonzero(views.point == number), set(frames.present)
    middle = np.array([camera.center_px for camera in frames.cameras])[views.camera[mine]]
    shares, best = list[dict[Look, float]](), None
    for k in mine[np.argsort(np.hypot(*(views.px[mine] - middle).T), kind="stable")].tolist():
        i, j, px = int(views.camera[k]), int(views.row[k]), views.px[k]
        if (i, j) not in present or len(shares) == _MOST_FRAMES:
            continue
        best = best or (i, j, round(float(px[0]), 1), round(float(px[1]), 1))
        seen = look_of(frames.prepared((i, j)).grey, px, size_mm * frames.cameras[i].px_per_mm)
        shares += [] if seen is None else [seen]
    # Every frame must show the same clear look.
    clear = {next((name for name, share in s.items() if share >= _LEAST_SHARE), None) for s in shares}
    look = clear.pop() if len(clear) == 1 else None
    state: State = "good" if look == (mark.good or "blank") else "bad" if look == mark.bad else "doubtful"
    mean: dict[str, float] = {name: round(float(np.mean([s[name] for s in shares])), 3) for name in (shares or [{}])[0]}
    return MarkReading(mark, state, look, mean, len(shares), best)


def look_of(grey: NDArray[np.uint8], px: Floats, size_px: float) -> dict[Look, float] | None:
    """Return which shares of a mark at `px` (2,) look dark, light and blank against the ring around it."""
    x, y = round(float(px[0])), round(float(px[1]))
    reach = int(np.ceil(_RING[1] * size_px)) + 1
    if size_px < _LEAST_PX or not (reach <= x < grey.shape[1] - reach and reach <= y < grey.shape[0] - reach):
        return None
    part = grey[y - reach : y + reach + 1, x - reach : x + reach + 1].astype(np.float64)
    across = np.arange(-reach, reach + 1)
    distance = np.hypot(across[None] + x - px[0], across[:, None] + y - px[1]) / size_px
    disc, ring = part[distance <= _INNER], part[(distance >= _RING[0]) & (distance <= _RING[1])]
    around = float(np.median(ring))
    if max(around, float(np.median(disc))) < _LEAST_GREY or around >= _MOST_GREY:
        return None
    contrast = (disc - around) / np.maximum(disc + around, 1.0)
    return {
        "dark": float((contrast <= -_CONTRAST).mean()),
        "light": float((contrast >= _CONTRAST).mean()),
        "blank": float((np.abs(contrast) <= _BLANK).mean()),
    }


def board_reasons(places: Mapping[str, OwnPlace], px_per_mm: float, *, searched: bool = True) -> Iterator[Reason]:
    """Yield the reasons for boards of a panel that their fiducials do not place, or not well.

    `places` are the boards' places by position; `searched` is false if the method of the run uses no fiducials.
    """
    check = "check these fiducials on the board and in the CAD data"
    if not searched:
        check = "the method of this run uses no fiducials: stitch it with the method auto, features or fiducials"
    if refused := [f"{at}: {place.refusal}" for at, place in places.items() if place.refusal]:
        sigma = max(place.sigma_mm for place in places.values() if place.refusal)
        yield Reason(
            ReasonCode.BOARD_UNPLACED,
            f"{len(refused)} of {len(places)} boards of the panel follow the panel, with ± {sigma:.2f} mm, because "
            f"their fiducials do not place them ({_named(refused)}): {check}",
        )
    placed = {at: place for at, place in places.items() if not place.refusal}
    if alone := [f"{at}: {place.fiducials[0]}" for at, place in placed.items() if len(place.fiducials) == 1]:
        yield Reason(
            ReasonCode.BOARD_UNPLACED,
            f"one fiducial alone places {len(alone)} of {len(places)} boards of the panel, so that their turn is not "
            f"known ({_named(alone)}): {check}, or give the board type two fiducials of each board",
        )
    for at, place in placed.items():
        if (off_px := place.off_mm * px_per_mm) > _LIMIT_PX:
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
        doubtful = [_shown(reading) for reading in board.marks if reading.state == "doubtful"]
        yield Reason(
            ReasonCode.BAD_BOARD_DOUBTFUL,
            f"it is not clear whether board {at} of the panel is crossed out, so it is not skipped: "
            f"{'; '.join(doubtful) or 'its marks contradict one another'}. Inspect the mark on the board, mark or "
            "clean it, and compare `good` and `bad` of the mark in the board type",
        )


def _shown(reading: MarkReading) -> str:
    mark = reading.mark
    where = f"mark {mark.name} at CAD ({mark.x:g}, {mark.y:g})"
    if reading.place is not None:
        camera, row, x, y = reading.place
        where += f", camera {camera} row {row} at ({x:.0f}, {y:.0f}) px,"
    if not reading.frames:
        return f"{where} is in no frame that shows it completely, large and bright enough"
    shares = ", ".join(f"{share:.0%} {look}" for look, share in reading.shares.items())
    return f"{where} is {shares} (80 % must be {mark.good or 'blank'} on a good board, {mark.bad} on a bad one)"


def _named(boards: list[str]) -> str:
    more = f"; and {len(boards) - _MOST_NAMED} more" if len(boards) > _MOST_NAMED else ""
    return "; ".join(boards[:_MOST_NAMED]) + more
