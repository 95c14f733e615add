"""The codes of one run: where they are searched, in which order pictures are tried, and when a code counts as read."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry import Camera, apply
from vaoi_station.geometry.homographies import between
from vaoi_station.geometry.transforms import Floats
from vaoi_station.identity.symbols import Symbol, read_dotted, read_symbols
from vaoi_station.model import BoardCode, BoardIdentity, BoardReading, BoardType, Stitch
from vaoi_station.mosaic.grid import MosaicGrid, Region
from vaoi_station.mosaic.reduction import shrunk
from vaoi_station.pixel_formats import eight_bit_grey

FrameKey = tuple[int, int]
MOST_PX = 2_000_000
"""Largest number of pixels of a picture."""
_FLAGS = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
_LEAST_OVERLAP_PX = 100
"""Number of shared pixels from which the brightness of two frames is matched."""


class RegionPictures:
    """Draws regions of one run's board."""

    def __init__(
        self,
        board_type: BoardType,
        stitch: Stitch,
        cameras: Sequence[Camera],
        frames: Collection[FrameKey],
        frame: Callable[[int, int], NDArray[np.generic] | None],
    ) -> None:
        """Store the run; raise `StateError` if it has no CAD mapping."""
        self._board_type, self._projector, self._frame = board_type, FrameIndex.of_result(stitch, cameras), frame
        self._placed = [key for key in sorted(frames) if self._projector.places(*key)]
        self._grey: dict[tuple[FrameKey, int], NDArray[np.uint8] | None] = {}

    @property
    def px_per_mm(self) -> float:
        """Mean resolution of the cameras."""
        return self._projector.px_per_mm

    def grid(self, region: Region, px_per_mm: float) -> MosaicGrid:
        """Return the grid of a picture of a region, with a lower resolution where it would be too large."""
        x0, y0, x1, y1 = region
        area_mm2 = abs((x1 - x0) * (y1 - y0)) * self._board_type.mm_per_unit**2
        fitting = min(px_per_mm, 0.999 * (MOST_PX / area_mm2) ** 0.5)
        return MosaicGrid.of_board(self._board_type, fitting, region)

    def draw(self, grid: MosaicGrid, choice: int) -> tuple[NDArray[np.uint8], FrameKey | None] | None:
        """Draw a region from its best frame, or from the frame with the number `choice` after it.

        Returns the picture, and its frame if that shows all of it; None if no such frame shows any of it. Where a frame
        does not show all of the region, the next ones fill the rest, with their brightness matched.
        """
        order = self._order(grid)
        if choice >= len(order):
            return None
        picture = np.zeros((grid.height, grid.width), np.uint8)
        seen = np.zeros(picture.shape, np.bool_)
        for key, whole in order[choice:] + order[:choice]:
            more, covered = self._warped(key, grid)
            if more is None or not (covered & ~seen).any():
                continue
            if whole and not seen.any():
                return more, key
            gain = _gain(picture, more, seen & covered)
            picture = np.where(seen, picture, np.clip(more * gain, 0, 255).astype(np.uint8))
            seen |= covered
            if seen.all():
                break
        return (picture, None) if seen.any() else None

    def _order(self, grid: MosaicGrid) -> list[tuple[FrameKey, bool]]:
        """Return the frames that show some of a region and whether each shows all of it; the best ones first."""
        w, h = grid.width, grid.height
        border = np.array([(x * w / 2 - 0.5, y * h / 2 - 0.5) for y in range(3) for x in range(3)])
        cad = apply(grid.cad_from_mosaic, border)
        found = []
        for key in self._placed:
            camera = self._projector.cameras[key[0]]
            raw = self._projector.raw_px(*key, cad)
            limits = (camera.width_px - 1, camera.height_px - 1)
            if (raw.max(0) < 0).any() or (raw.min(0) > limits).any():
                continue
            whole = bool((raw >= 0).all() and (raw <= limits).all())
            found.append((not whole, float(np.hypot(*self._projector.from_foot_mm(*key, cad[4]))), key))
        return [(key, not partly) for partly, _, key in sorted(found)]

    def _warped(self, key: FrameKey, grid: MosaicGrid) -> tuple[NDArray[np.uint8] | None, NDArray[np.bool_]]:
        """Return the picture of a region by one frame, and which of its pixels the frame shows."""
        camera = self._projector.cameras[key[0]]
        # Of frames that are much finer than the picture, every pixel averages several: sampling would alias.
        factor = max(int(camera.px_per_mm / grid.px_per_mm + 0.2), 1)
        frame = self._shrunk(key, factor)
        if frame is None:
            return None, np.zeros((grid.height, grid.width), np.bool_)
        exact = self._projector.matrix(*key, grid.cad_from_mosaic, (0, 0, grid.width, grid.height))
        matrix: Floats = between(exact, factor, 1)
        size = (grid.width, grid.height)
        picture = np.asarray(cv2.warpPerspective(frame, matrix, size, flags=_FLAGS), np.uint8)
        shown = cv2.warpPerspective(np.ones_like(frame), matrix, size, flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP)
        return picture, np.asarray(shown, np.bool_)

    def _shrunk(self, key: FrameKey, factor: int) -> NDArray[np.uint8] | None:
        at = (key, factor)
        if at not in self._grey:
            pixels = self._frame(*key)
            self._grey[at] = None if pixels is None else np.asarray(shrunk(eight_bit_grey(pixels), factor), np.uint8)
        return self._grey[at]


def _gain(picture: NDArray[np.uint8], more: NDArray[np.uint8], shared: NDArray[np.bool_]) -> float:
    """Return the factor by which the brightness of a further frame is matched to that of a picture."""
    if int(shared.sum()) < _LEAST_OVERLAP_PX:
        return 1.0
    return float(np.clip(picture[shared].mean() / max(float(more[shared].mean()), 1.0), 0.2, 5.0))


SEARCH_PX_PER_MM = 25.0
"""Resolution at which a whole board is searched: modules of 0.2 mm are then 5 px."""
_TILE_MM, _LARGEST_MM = 24.0, 10.0
"""Side of the squares in which a whole board is searched, and how far they overlap: the largest code that is found."""
_TRIES = (
    (0, 1, False), (0, 2, False), (0, 1, True), (1, 1, False), (1, 2, False), (2, 1, False), (2, 2, False),
    (1, 1, True), (2, 1, True),
)  # fmt: skip
"""Pictures of a region in the order in which they are tried: number of the frame, enlargement, and whether for dots.

Dots come late, because they take longest, but before other frames: a whole board would use up its time with those.
"""
_SAME_MODULES = 3.0
"""Distance of two readings of one code, in modules."""


class _Try(NamedTuple):
    """One picture of one region."""

    region: int
    choice: int
    enlarged: int
    dotted: bool


class Found(NamedTuple):
    """A code that was read in one picture."""

    code: BoardCode
    region: int
    tried: int
    """Number of the picture."""
    proven: bool = True
    """Whether its check words rule out another text; else a second frame must yield the same."""


class Progress(NamedTuple):
    """The readings so far, and the number of the next picture. It is sent from one slice of the work to the next."""

    readings: tuple[Found, ...] = ()
    next_try: int = 0
    ended: bool = False


class CodeReader:
    """Reads the codes of one run, in slices that the caller ends."""

    def __init__(self, board_type: BoardType, pictures: RegionPictures) -> None:
        """Plan the pictures. A board type without `identity` is searched everywhere for codes of any text."""
        self._board_type, self._pictures = board_type, pictures
        self.identity = board_type.identity or BoardIdentity()
        self._regions = _regions_of(board_type, self.identity)
        tries = [t for t in _TRIES if not t[2] or self.identity.symbology != "qr"]
        self._tries = tuple(_Try(n, *t) for t, n in itertools.product(tries, range(len(self._regions))))
        self._stated = bool(self.identity.places)

    def work(self, progress: Progress, more: Callable[[], bool]) -> Progress:
        """Try further pictures while `more()` is True, at least one; return the new progress."""
        readings, number = list(progress.readings), progress.next_try
        while number < len(self._tries):
            wanted = self._tries[number]
            if not self._is_read(wanted, readings):
                readings += self._read(wanted, number)
                if not more():
                    number += 1
                    break
            number += 1
        return Progress(tuple(readings), number, ended=number >= len(self._tries))

    def reading(self, progress: Progress) -> BoardReading:
        """Return the codes that count as read, in the order of the regions."""
        codes = [found for found in self._merged(progress.readings) if found is not None]
        places = self.identity.places
        there = {found.region for found in codes}
        return BoardReading(
            codes=tuple(found.code for found in sorted(codes, key=lambda f: (f.region, f.code.center))),
            unread_places=tuple(place for n, place in enumerate(places) if n not in there),
            complete=progress.ended,
        )

    def _is_read(self, wanted: _Try, readings: Sequence[Found]) -> bool:
        """Return whether a picture need not be tried, because its region or the board is read."""
        merged = self._merged(readings)
        if self._stated:
            return any(found.region == wanted.region and found.code.board_id is not None for found in merged)
        # The first picture of every region is tried in any case: a panel has several codes.
        return wanted[1:] != _TRIES[0] and any(f.code.board_id is not None for f in merged)

    def _read(self, wanted: _Try, number: int) -> list[Found]:
        grid = self._grid(wanted.region)
        drawn = self._pictures.draw(grid, wanted.choice)
        if drawn is None:
            return []
        picture, frame = drawn
        if wanted.dotted:
            symbols = read_dotted(picture)
        else:
            symbols = read_symbols(picture, self.identity.symbology, enlarged=wanted.enlarged, dotted=False)
        return [self._found(symbol, grid, wanted, number, frame) for symbol in symbols]

    def _grid(self, region: int) -> MosaicGrid:
        finest = self._pictures.px_per_mm
        return self._pictures.grid(self._regions[region], finest if self._stated else min(finest, SEARCH_PX_PER_MM))

    def _found(self, symbol: Symbol, grid: MosaicGrid, wanted: _Try, number: int, frame: FrameKey | None) -> Found:
        corners: Floats = apply(grid.cad_from_mosaic, symbol.corners_px)
        camera, row = (None, None) if frame is None else frame
        x, y = corners.mean(0)
        region = self._region_at(float(x), float(y), wanted.region) if self._stated else wanted.region
        code = BoardCode(
            text=symbol.text,
            symbology=symbol.symbology,
            board_id=self.identity.board_id(symbol.text),
            panel=self.identity.places[region].panel if self._stated else None,
            center=(round(float(x), 4), round(float(y), 4)),
            corners=tuple((round(float(u), 4), round(float(v), 4)) for u, v in corners),
            module_mm=round(symbol.module_px / grid.px_per_mm, 4),
            error_correction_used=symbol.error_correction_used,
            camera=camera,
            row=row,
        )
        return Found(code, region, number, symbol.proven)

    def _region_at(self, x: float, y: float, drawn: int) -> int:
        """Return the place that a code belongs to: of those that contain its centre, that with the nearest centre.

        Places may overlap, and the picture of one place then shows the code of another.
        """
        places = self.identity.places
        there = [n for n, (x0, y0, x1, y1) in enumerate(self._regions) if x0 <= x <= x1 and y0 <= y <= y1]
        return min(there, key=lambda n: math.dist((x, y), places[n].center), default=drawn)

    def _merged(self, readings: Sequence[Found]) -> list[Found]:
        """Return one reading of each code: that with the least error correction, if the readings suffice."""
        groups: list[list[Found]] = []
        for found in readings:
            group = next((g for g in groups if self._same(g[0].code, found.code)), [])
            if not group:
                groups.append(group)
            group.append(found)
        # Two pictures of one frame have the same noise and the same scratch, so they can show the same wrong text. One
        # that is put together from several frames may have that of each of them.
        frames = [{(f.code.camera, f.code.row) for f in group} - {(None, None)} for group in groups]
        sure = [g for g, of in zip(groups, frames, strict=True) if len(of) > 1 or any(f.proven for f in g)]
        return [min(group, key=lambda f: (f.code.error_correction_used, f.tried)) for group in sure]

    def _same(self, a: BoardCode, b: BoardCode) -> bool:
        apart = math.dist(a.center, b.center) * self._board_type.mm_per_unit
        return (a.text, a.symbology) == (b.text, b.symbology) and apart <= _SAME_MODULES * a.module_mm


def _regions_of(board_type: BoardType, identity: BoardIdentity) -> tuple[Region, ...]:
    """Return the regions in which codes are searched: the places of the board type, or squares over the board."""
    if identity.places:
        return tuple(
            (x - p.width / 2, y - p.height / 2, x + p.width / 2, y + p.height / 2)
            for p in identity.places
            for x, y in (p.center,)
        )
    low, high = board_type.extent()
    mm = board_type.mm_per_unit
    spans = [_spans(float(a), float(b), _TILE_MM / mm, _LARGEST_MM / mm) for a, b in zip(low, high, strict=True)]
    return tuple((x0, y0, x1, y1) for y0, y1 in spans[1] for x0, x1 in spans[0])


def _spans(low: float, high: float, side: float, overlap: float) -> list[tuple[float, float]]:
    """Return intervals of at most `side` that cover low to high and overlap by at least `overlap`."""
    if high - low <= side:
        return [(low, high)]
    count = int(np.ceil((high - low - overlap) / (side - overlap)))
    starts = np.linspace(low, high - side, count)
    return [(float(s), float(s) + side) for s in starts]


def read_codes(
    board_type: BoardType,
    stitch: Stitch,
    cameras: Sequence[Camera],
    frame: Callable[[int, int], NDArray[np.generic] | None],
) -> BoardReading:
    """Read the codes of a run; `frame` returns None for a missing frame. Raise `StateError` without a CAD mapping."""
    keys = [(i, j) for i, rows in enumerate(stitch.image_matrices) for j in range(len(rows))]
    reader = CodeReader(board_type, RegionPictures(board_type, stitch, cameras, keys, frame))
    return reader.reading(reader.work(Progress(), lambda: True))
