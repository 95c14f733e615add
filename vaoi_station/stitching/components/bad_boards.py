"""Reasons of a verdict that concern single boards of a panel: which fiducials do not place them, and what follows.

Read the bad-board marks of a panel: marks by which operators and earlier machines cross out single boards.

A mark looks dark, light or blank (as what surrounds it). The board type states how it looks on good and on bad boards.
A look that is neither, or not clear, leaves the board in doubt: it is tested, and the verdict names it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.frame_index import FootprintViews
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType, OtherMark, Reason, ReasonCode, Surface
from vaoi_station.model.board_type import Look
from vaoi_station.stitching.components.places import OwnPlace
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.stitching.matching.frames import Scene

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


class MarkedPanel(NamedTuple):
    """A panel with its position."""

    board_type: BoardType
    cad_matrix: Floats
    of_boards: Mapping[str, Floats]
    """C of the boards that have one, by position."""
    rows: Floats
    """(m, 3, 3) the matrices D_j."""
    surface: Surface | None


@dataclass(frozen=True)
class MarkReading:
    """What the frames show of one mark."""

    name: str
    state: State
    look: Look | None
    """None if it is not clear, or no frame shows the mark."""
    shares: dict[str, float]
    """Mean share of the mark's disc that looks dark, light and blank."""
    frames: int
    """Number of frames that show the mark well."""
    cad: tuple[float, float]
    place: tuple[int, int, float, float] | None
    """Camera, row and raw pixels of the mark in the frame that shows it best; None if none shows it."""
    expected: tuple[Look, Look]
    """Its look on good and on bad boards."""


@dataclass(frozen=True)
class BoardMarks:
    """The state of one board of a panel, by its marks."""

    state: State
    marks: tuple[MarkReading, ...]


def read_bad_marks(panel: MarkedPanel, scene: Scene, confirmed: Collection[FrameKey]) -> dict[str, BoardMarks]:
    """Read the bad-board marks of all boards of a panel; return the boards' states by position.

    Args:
        confirmed: the frames that may be read.
    """
    marks = [mark for mark in panel.board_type.other_marks or () if mark.read]
    if not marks:
        return {}
    back = np.linalg.inv(panel.cad_matrix)
    own = [back @ panel.of_boards.get(str(mark.panel), panel.cad_matrix) for mark in marks]
    at = np.array([apply(move, np.array([mark.x, mark.y])) for move, mark in zip(own, marks, strict=True)])
    views = replace(scene.index(panel.rows, panel.surface), tester_from_cad=panel.cad_matrix).views(at)
    found: dict[str, list[MarkReading]] = {}
    for n, mark in enumerate(marks):
        size_mm = mark.diameter * panel.board_type.mm_per_unit
        found.setdefault(str(mark.panel), []).append(_read(mark, n, views, scene, confirmed, size_mm))
    return {position: BoardMarks(_together(readings), tuple(readings)) for position, readings in found.items()}


def look_of(grey: NDArray[np.uint8], px: Floats, size_px: float) -> dict[str, float] | None:
    """Return which shares of a mark look dark, light and blank against the ring around it.

    None if the frame does not show it with this ring, or too small, too dark or saturated.

    Args:
        px: (2,) centre of the mark, raw pixels.
        size_px: its diameter.
    """
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


def _read(
    mark: OtherMark, number: int, views: FootprintViews, scene: Scene, confirmed: Collection[FrameKey], size_mm: float
) -> MarkReading:
    """Read one mark in the frames that show it nearest to their middle; `number` is that of its views."""
    mine = np.flatnonzero(views.point == number)
    middle = np.array([camera.center_px for camera in scene.cameras])[views.camera[mine]]
    order = mine[np.argsort(np.hypot(*(views.px[mine] - middle).T), kind="stable")]
    places = [(int(views.camera[k]), int(views.row[k]), views.px[k]) for k in order.tolist()]
    shares: list[dict[str, float]] = []
    best = None
    for i, j, px in places:
        if (i, j) not in confirmed or len(shares) == _MOST_FRAMES:
            continue
        best = best or (i, j, round(float(px[0]), 1), round(float(px[1]), 1))
        seen = look_of(scene.prepared((i, j)).grey, px, size_mm * scene.cameras[i].px_per_mm)
        if seen is not None:
            shares.append(seen)
    assert mark.bad is not None  # other marks are not read
    good, bad = mark.good or "blank", mark.bad
    look = _common_look(shares)
    state: State = "good" if look == good else "bad" if look == bad else "doubtful"
    looks: tuple[Look, ...] = ("dark", "light", "blank")
    mean: dict[str, float] = (
        {name: round(float(np.mean([s[name] for s in shares])), 3) for name in looks} if shares else {}
    )
    return MarkReading(mark.name, state, look, mean, len(shares), (mark.x, mark.y), best, (good, bad))


def _common_look(shares: list[dict[str, float]]) -> Look | None:
    """Return the look that every frame shows; None if frames differ, or one of them is not clear."""
    looks: set[Look | None] = set()
    for seen in shares:
        clear: list[Look] = [name for name in ("dark", "light", "blank") if seen[name] >= _LEAST_SHARE]
        looks.add(clear[0] if clear else None)
    return looks.pop() if len(looks) == 1 else None


def _together(readings: list[MarkReading]) -> State:
    """Return the state of a board by all its marks; they must agree."""
    states = {reading.state for reading in readings}
    return states.pop() if len(states) == 1 else "doubtful"


_LIMIT_PX = 0.3
"""Largest accepted distance of a fiducial from the place that shift and turn of its board give it."""
_MOST_NAMED = 4


def board_reasons(places: Mapping[str, OwnPlace], px_per_mm: float, *, searched: bool = True) -> Iterator[Reason]:
    """Yield the reasons for boards of a panel that their fiducials do not place, or not well.

    Args:
        places: the boards' places, by position.
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
