"""Fiducials: detected in frames, assigned to those of the board type, which gives a first C, and located again.

Handedness follows from board type and cameras, never from the detections. The fiducials are the set of detections whose
distances, direction and scores fit the CAD data best (paper, section 3.3.4). If the outline is known, linked texture
must lie inside it.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry import Camera
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.similarity import apply_similarity
from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks import Mark, find_candidates, locate_mark
from vaoi_station.marks.candidate_search import reduction_factor
from vaoi_station.marks.mark_shape import Shape
from vaoi_station.model import BoardType, Fiducial, ReasonCode
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.problem import FIXTURE, FiducialPoints, Ints
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.expectation import Expectation
from vaoi_station.stitching.matching.evidence import Detections, FrameKey, Task
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene

Complex = NDArray[np.complex128]

_MOST_PER_FRAME, _MOST_WHEN_LOST = 12, 80
"""Largest number of detections per frame and kind: at first, and if no board was found among them."""
_SMALL = 1.12
"""Factor on a mark's size before the reduction of the frame is chosen, so that similar cameras get the same one."""
_SAME_PLACE_MM = 0.4
LOCAL_MM = 0.5
"""Standard deviation against C of fiducials that have no part in it: of components, or of a board of a panel."""
BOARD_MM = 1.2
"""Largest distance of a fiducial of a board of a panel from the place that the first C gives it."""
_UNLIKE_MM, _NEARER, _TURN_RAD = 0.25, 0.1, np.radians(1.5)
"""Limits of a pair of candidates of one board: difference of their distance from that of the fiducials, share of the
displacement that is added to it, and turn."""
_SCALE_SIGMA, _SCORE_SIGMA, _UNMATCHED_COST = 1.0e-3, 0.02, 50.0
"""Standard deviations of scale and score in the cost of a C, and the cost of a fiducial without a candidate."""
_TEXTURE_MARGIN_MM, _MOST_OUTSIDE = 1.0, 0.25
"""Points outside the outline by more than this margin lie off the board; if more than this share do, C is rejected."""
_SCALE_LIMIT, _SLACK_MM = 4e-3, 0.15
_ROUGH_FACTOR, _MOST_PLACES = 4.0, 6
"""While the motion of the board is uncertain: factor on the limits of the scale of C and of the distance between a
fiducial and its candidate, and largest number of positions of the board that are tried."""
_MOST_PAIRS, _MOST_OWN_PAIRS = 24, 200
"""Largest number of pairs of fiducials that are tried: of a panel's boards, and of the board or panel itself."""


def mark_kinds(board_type: BoardType) -> tuple[tuple[Shape, float], ...]:
    """List the kinds (shape, size in mm) of a board type's fiducials, each once, in order of appearance."""
    return tuple(dict.fromkeys(_kind_of(f, board_type) for f in board_type.fiducials))


def fixture_kind(board_type: BoardType) -> tuple[Shape, float] | None:
    """Return the kind (shape, size in mm) of the fixture marks, numbered after `mark_kinds`; None if there are none."""
    mark = board_type.fixture_mark
    if mark is None or not board_type.fixture_marks:
        return None
    return mark.shape, round(mark.size * board_type.mm_per_unit, 6)


def _kind_numbers(board_type: BoardType) -> list[int]:
    kinds = mark_kinds(board_type)
    return [kinds.index(_kind_of(f, board_type)) for f in board_type.fiducials]


def _kind_of(fiducial: Fiducial, board_type: BoardType) -> tuple[Shape, float]:
    return fiducial.shape, round(fiducial.diameter * board_type.mm_per_unit, 6)


def detect_marks(
    task: Task,
    frame: PreparedFrame,
    camera: Camera,
    board_type: BoardType | None,
    *,
    fixture: bool = False,
    most: int = _MOST_PER_FRAME,
) -> Detections:
    """Detect the `most` places of each kind that look most like fiducials, with `fixture` also like fixture marks."""
    marks: list[tuple[Mark, int]] = []
    kinds = list(mark_kinds(board_type)) if board_type else []
    own = fixture_kind(board_type) if board_type and fixture else None
    for kind, (shape, size_mm) in enumerate([*kinds, own] if own else kinds):
        size_px = size_mm * camera.px_per_mm
        rough: Iterable[Mark | Failure] = _search_kind(frame, shape, size_px, most)
        # `relocate_fiducials` locates fiducials precisely later. Fixture marks are located precisely here.
        if kind == len(kinds):
            rough = [locate_mark(frame.grey, mark.px, shape, size_px) for mark in rough if isinstance(mark, Mark)]
        marks += [(mark, kind) for mark in rough if isinstance(mark, Mark)]
    return Detections(
        task,
        np.array([m.px for m, _ in marks]).reshape(-1, 2),
        np.array([m.sigma_px for m, _ in marks]),
        np.array([m.score for m, _ in marks]),
        np.array([k for _, k in marks], dtype=np.int_),
    )


def _search_kind(frame: PreparedFrame, shape: Shape, size_px: float, most: int) -> list[Mark]:
    """Search marks of one kind in a reduced frame, where they are 5 to 9 px wide, and locate them at twice that."""
    coarse = reduction_factor(_SMALL * size_px)
    fine = max(coarse // 2, 1)
    places, _ = find_candidates(frame.reduced(coarse), shape, size_px / coarse, most)
    marks = []
    for place in (places + 0.5) * (coarse / fine) - 0.5:
        mark = locate_mark(frame.reduced(fine), place, shape, size_px / fine, precise=False)
        if isinstance(mark, Mark):
            marks.append(replace(mark, px=(mark.px + 0.5) * fine - 0.5, sigma_px=mark.sigma_px * fine))
    return marks


def detect_more_marks(
    board_type: BoardType, scene: Scene, detections: Sequence[Detections], *, fixture: bool
) -> list[Detections]:
    """Search the frames of the given detections again, with a larger limit on the number of detections per frame."""
    return [
        detect_marks(t, scene.prepared(t.a), scene.cameras[t.a[0]], board_type, fixture=fixture, most=_MOST_WHEN_LOST)
        for t in (s.task for s in detections)
    ]


def relocate_fiducials(
    board_type: BoardType, places_mm: Floats, scene: Scene, motion: Motion, detections: Sequence[Detections]
) -> list[Detections]:
    """Locate precisely each fiducial that a frame must show; all other detections are returned unchanged."""
    kinds, kind = mark_kinds(board_type), _kind_numbers(board_type)
    expected: dict[FrameKey, list[tuple[int, Floats]]] = {}
    views = scene.index(motion.rows_from_tester).views(places_mm)
    for n, key, px in zip(views.point.tolist(), views.frames, views.px, strict=True):
        if scene.cameras[key[0]].sees(px[None])[0]:
            expected.setdefault(key, []).append((n, px))
    out = []
    for s in detections:
        for n, px in expected.get(s.task.a, ()):
            shape, size_mm = kinds[kind[n]]
            size_px = size_mm * scene.cameras[s.task.a[0]].px_per_mm
            near = np.hypot(*(s.px - px).T) < size_px / 3
            # The search starts at a detection if there is one: C from two fiducials may be off by some pixels far from
            # these.
            start = s.px[near][s.score[near].argmax()] if near.any() else px
            mark = locate_mark(scene.prepared(s.task.a).grey, start, shape, size_px)
            if isinstance(mark, Mark):
                sigma, score = np.append(s.sigma_px[~near], mark.sigma_px), np.append(s.score[~near], mark.score)
                kinds_of = np.append(s.kind[~near], kind[n]).astype(np.int_)
                s = Detections(s.task, np.vstack([s.px[~near], mark.px]), sigma, score, kinds_of)  # noqa: PLW2901
        out.append(s)
    return out


def displaced_places(board_type: BoardType, places: Floats, mm: Floats, kind: NDArray[np.int_]) -> Floats:
    """Return the predicted places (k, 2) of fiducials, those of a panel's boards displaced as their candidates show.

    The pair of candidates that fits the distance of two fiducials best shows shift and turn of their board. `mm` (n, 2)
    and `kind` (n,) are the candidates; all places are in tester coordinates.
    """
    kinds, out = _kind_numbers(board_type), places.copy()
    for position, numbers in board_type.board_fiducials.items():
        of = [np.flatnonzero(kind == kinds[n]) for n in numbers]
        near = [at[np.hypot(*(mm[at] - places[n]).T) < BOARD_MM] for n, at in zip(numbers, of, strict=True)]
        best, least = None, _UNLIKE_MM
        for (a, at_a), (b, at_b) in combinations(zip(numbers, near, strict=True), 2):
            arrow = complex(*(places[b] - places[a]))
            for p, q in product(at_a.tolist(), at_b.tolist()):
                found = complex(*(mm[q] - mm[p]))
                # Of equal fits, the smaller displacement is the likelier one.
                off = abs(abs(found) - abs(arrow)) + _NEARER * abs(complex(*(mm[p] - places[a])))
                if off < least and abs(found) > 0 and abs(np.angle(found / arrow)) < _TURN_RAD:
                    best, least = (places[a], mm[p], found / arrow / abs(found / arrow)), off
        if best is None:
            continue
        start, end, turn = best
        mine = [n for n, f in enumerate(board_type.fiducials) if f.panel is not None and str(f.panel) == position]
        moved = (places[mine] - start) @ (1, 1j) * turn
        out[mine] = end + np.stack([moved.real, moved.imag], -1)
    return np.asarray(out)


@dataclass(frozen=True, eq=False)
class FiducialCandidates:
    """k candidates: positions `mm` (k, 2) of possible marks on the board, with kind (k,) and score (k,)."""

    mm: Floats
    kind: NDArray[np.int_]
    score: Floats


def merge_detections(detections: Sequence[Detections], cameras: Sequence[Camera], motion: Motion) -> FiducialCandidates:
    """Merge detections of the same mark in several frames into one candidate: the detection with the best score."""
    seen = [s for s in detections if len(s.px)]
    if not seen:
        return FiducialCandidates(np.zeros((0, 2)), np.zeros(0, dtype=np.int_), np.zeros(0))
    mm, kind, score = (
        _to_board(seen, cameras, motion)[2],
        *(np.concatenate(values) for values in ([s.kind for s in seen], [s.score for s in seen])),
    )
    best_first = np.argsort(-score, kind="stable")
    mm, kind, score = mm[best_first], kind[best_first].astype(np.int_), score[best_first]
    kept = keep_distinct(mm, kind, _SAME_PLACE_MM)
    return FiducialCandidates(mm[kept], kind[kept], score[kept])


def _to_board(
    detections: Sequence[Detections], cameras: Sequence[Camera], motion: Motion
) -> tuple[NDArray[np.int_], Floats, Floats]:
    """Return camera (k,), ground point (k, 2) and board point (k, 2) of each of the k detections, in order."""
    count = [len(s.px) for s in detections]
    camera = np.repeat(np.array([s.task.a[0] for s in detections], dtype=np.int_), count)
    px, ground = np.concatenate([s.px for s in detections]), np.empty((sum(count), 2))
    for i in np.unique(camera).tolist():
        ground[camera == i] = cameras[i].ground(px[camera == i])
    return camera, ground, motion.board(np.repeat([s.task.a[1] for s in detections], count), ground)


@compiled
def keep_distinct(mm: Floats, kind: NDArray[np.int_], apart_mm: float) -> NDArray[np.bool_]:
    """Return for each of k points (k, 2) whether no earlier kept point of its kind (k,) lies closer than `apart_mm`."""
    kept = np.zeros(len(mm), np.bool_)
    for n in range(len(mm)):
        kept[n] = True
        for m in range(n):
            if kept[m] and kind[m] == kind[n] and math.hypot(mm[m, 0] - mm[n, 0], mm[m, 1] - mm[n, 1]) < apart_mm:
                kept[n] = False
                break
    return kept


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A possible first C, with a cost that states how badly it fits, and the fiducials that it fits."""

    c: Floats
    cost: float
    fiducials: tuple[int, ...]
    ambiguous: bool = False


@dataclass(frozen=True, eq=False)
class _Pair:
    """A similarity C by which two candidates are two fiducials, with its deviations from what is expected."""

    c: Floats
    candidates: dict[int, int]
    """Number of the candidate of each of the two fiducials."""
    turn_rad: float
    scale: float


def find_board(
    plane: BoardPlane, places: FiducialCandidates, angle_rad: float, expectation: Expectation, texture_mm: Floats
) -> Hypothesis | Failure:
    """Find the similarity under which the detections fit the board's fiducials at the least cost.

    `angle_rad` is the expected direction of the flat x axis, in tester coordinates, and `texture_mm` (k, 2) are linked
    points, which should lie on the board.
    """
    board_type = plane.board_type
    if len(board_type.fiducials) < 2:
        few = f"board type {board_type.name!r} has {len(plane.fiducials)} fiducials; two are needed for the CAD mapping"
        return Failure(few, ReasonCode.TOO_FEW_FIDUCIALS)
    best: Hypothesis | None = None
    nearest: tuple[float, str] = (np.inf, "")
    search = _Search.of(plane, places, angle_rad, expectation)
    for pair in search.pairs(_SCALE_LIMIT):
        off = max(abs(pair.turn_rad) / expectation.angle_tolerance_rad, abs(pair.scale) / _SCALE_LIMIT)
        if off > 1:
            # This text is used in the message of a failure only. It shows the engineer what was nearly accepted.
            what = f"turned by {np.degrees(pair.turn_rad):.1f}°, scale off by {pair.scale:.2%}"
            nearest = min(nearest, (off, what))
            continue
        cost, used = search.cost(pair)
        if best is None or cost < best.cost:
            outside = outside_share(plane, pair.c, texture_mm)
            cost += 400.0 * max(outside - 0.02, 0.0)
            if outside <= _MOST_OUTSIDE and (best is None or cost < best.cost):
                best = Hypothesis(pair.c, cost, used)
    if best is not None:
        return best
    seen = f"{len(places.mm)} place(s) look like fiducials"
    hint = f"; the nearest fit is {nearest[1]}" if nearest[1] else ""
    nowhere = f"the fiducials of {board_type.name!r} are not where they should be: {seen}, no pair fits{hint}"
    todo = "compare fiducials, expected position and angle with the board"
    return Failure(f"{nowhere}; {todo}", ReasonCode.FIDUCIALS_NOT_FOUND)


def find_rough_places(
    plane: BoardPlane, places: FiducialCandidates, angle_rad: float, expectation: Expectation
) -> list[Hypothesis]:
    """List the positions of the board that the detections allow while the motion is uncertain, most likely first."""
    limit, every = _ROUGH_FACTOR * _SCALE_LIMIT, []
    search = _Search.of(plane, places, angle_rad, expectation)
    for pair in search.pairs(limit):
        if abs(pair.turn_rad) <= expectation.angle_tolerance_rad and abs(pair.scale) <= limit:
            every.append(Hypothesis(pair.c, *search.cost(pair, _ROUGH_FACTOR)))
    every.sort(key=lambda h: h.cost)
    kept: list[Hypothesis] = []
    middle = plane.fiducials.mean(0)[None] if len(plane.fiducials) else np.zeros((1, 2))
    for h in every:
        at = apply_similarity(h.c, middle)[0]
        if all(np.hypot(*(apply_similarity(k.c, middle)[0] - at)) > 2 * _SAME_PLACE_MM for k in kept):
            kept.append(h)
        if len(kept) == _MOST_PLACES:
            break
    return kept


def _pairs_to_try(plane: BoardPlane) -> list[tuple[int, int]]:
    """List the pairs of fiducials that may locate the board: if there are many, those farthest apart."""
    of_boards = {n for numbers in plane.board_type.board_fiducials.values() for n in numbers}
    every = list(combinations(range(len(plane.fiducials)), 2))
    if len(every) > _MOST_PAIRS:
        every.sort(key=lambda pair: -math.dist(*plane.fiducials[list(pair)]))
    panel = [pair for pair in every if not of_boards.intersection(pair)]
    others = [pair for pair in every if of_boards.intersection(pair)]
    return panel[:_MOST_OWN_PAIRS] + others[:_MOST_PAIRS]


class _Search(NamedTuple):
    """A search of the board among n candidates, with all points as complex numbers x + iy."""

    plane: BoardPlane
    flat: Complex  # (f,) the fiducials, flat coordinates
    corners: Complex  # (4,) of the board's extent, flat coordinates
    at: Complex  # (n,) the candidates, tester coordinates
    score: Floats  # (n,)
    alike: NDArray[np.bool_]  # (f, n) whether a candidate is of the kind of a fiducial
    angle_rad: float
    expectation: Expectation

    @staticmethod
    def of(plane: BoardPlane, places: FiducialCandidates, angle_rad: float, expectation: Expectation) -> _Search:
        """Prepare a search for a board whose x axis is expected in a direction, tester coordinates."""
        (x0, y0), (x1, y1) = plane.extent
        corners = plane.flat(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))
        flat, corner, at = (np.asarray(p @ (1, 1j), np.complex128) for p in (plane.fiducials, corners, places.mm))
        alike = np.array(_kind_numbers(plane.board_type))[:, None] == places.kind
        return _Search(plane, flat, corner, at, places.score, alike, angle_rad, expectation)

    def pairs(self, scale_limit: float) -> Iterator[_Pair]:
        """Yield the C of all pairs of candidates whose distance is about that of two fiducials."""
        flat, mm_per_unit = self.flat.tolist(), self.plane.board_type.mm_per_unit
        of = [np.flatnonzero(alike) for alike in self.alike]
        for i, j in _pairs_to_try(self.plane):
            to = flat[j] - flat[i]
            arrow = self.at[of[j]] - self.at[of[i]][:, None]
            slack = 2 * scale_limit * abs(to) * mm_per_unit + _SLACK_MM
            for k, n in np.argwhere(np.abs(np.abs(arrow) - abs(to) * mm_per_unit) <= slack).tolist():
                turn = complex(arrow[k, n]) / to
                shift = complex(self.at[of[i][k]]) - turn * flat[i]
                c = np.array([turn.real, turn.imag, shift.real, shift.imag])
                off = (cmath.phase(turn) - self.angle_rad + np.pi) % (2 * np.pi) - np.pi
                yield _Pair(c, {i: int(of[i][k]), j: int(of[j][n])}, off, abs(turn) / mm_per_unit - 1)

    def cost(self, pair: _Pair, rough: float = 1.0) -> tuple[float, tuple[int, ...]]:
        """Return the cost of a C by scores of the candidates near its fiducials, scale, turn and place, and these."""
        a, b, x, y = pair.c.tolist()
        turn, shift, expectation = complex(a, b), complex(x, y), self.expectation
        off = np.where(self.alike, np.abs(self.at - (turn * self.flat + shift)[:, None]), np.inf)
        for fiducial, candidate in pair.candidates.items():
            off[fiducial, candidate] = -1.0
        nearest = off.argmin(1)
        used = np.flatnonzero(off[np.arange(len(off)), nearest] < rough * _SAME_PLACE_MM)
        cost = float((((1 - self.score[nearest[used]]) / _SCORE_SIGMA) ** 2).sum())
        cost += _UNMATCHED_COST * (len(off) - len(used))
        cost += (pair.scale / (rough * _SCALE_SIGMA)) ** 2 + (2 * pair.turn_rad / expectation.angle_tolerance_rad) ** 2
        corners = turn * self.corners + shift
        for place, expected in zip((corners.real.min(), corners.imag.min()), expectation.corner_mm, strict=True):
            if expected is not None:
                cost += ((float(place) - expected) / expectation.tolerance_mm) ** 2
        return cost, tuple(used.tolist())


def outside_share(plane: BoardPlane, c: Floats, texture_mm: Floats) -> float:
    """Compute the share of textured points outside the board for a given C; 0 without outline or with fixture marks."""
    board_type = plane.board_type
    # A fixture has texture beside the board, so texture there is no sign of a wrong C.
    if board_type.outline is None or board_type.fixture_marks or not len(texture_mm):
        return 0.0
    (x0, y0), (x1, y1) = plane.extent
    margin, (a, b, x, y) = _TEXTURE_MARGIN_MM / board_type.mm_per_unit, c.tolist()
    flat = (texture_mm @ (1, 1j) - complex(x, y)) / complex(a, b)
    u, v = flat.real, -flat.imag if plane.mirrored else flat.imag
    off = (u < x0 - margin) | (u > x1 + margin) | (v < y0 - margin) | (v > y1 + margin)
    return float(off.mean())


def assign_fiducials(
    plane: BoardPlane,
    c: Floats,
    detections: Sequence[Detections],
    cameras: Sequence[Camera],
    motion: Motion,
    places_mm: Floats | None = None,
) -> FiducialPoints:
    """Select the detections that are fiducials or fixture marks under a first C, and return them as observations.

    `places_mm` (k, 2) are the predicted places of the fiducials, where the first C does not give them.
    """
    board_type, kinds = plane.board_type, _kind_numbers(plane.board_type)
    flat, number = plane.fiducials, np.arange(len(kinds))
    if fixture_kind(board_type) is not None:
        marks = plane.flat(np.array([(m.x, m.y) for m in board_type.fixture_marks]))
        kinds += [len(mark_kinds(board_type))] * len(marks)
        flat, number = np.vstack([flat, marks]), np.append(number, np.full(len(marks), FIXTURE))
    seen = [s for s in detections if len(s.px)]
    if not seen:
        return FiducialPoints.empty()
    camera, ground, board = _to_board(seen, cameras, motion)
    ends = np.append(0, np.cumsum([len(s.px) for s in seen]))
    of_seen = np.concatenate([s.kind for s in seen]).astype(np.int_)
    expected = apply_similarity(c, flat)
    if places_mm is not None:
        expected[: len(places_mm)] = places_mm
    at, mark = match_nearest(board, of_seen, ends, expected, np.array(kinds, dtype=np.int_), _SAME_PLACE_MM)
    row = np.repeat([s.task.a[1] for s in seen], np.diff(ends))[at]
    camera, ground, lean, resolution = camera[at], ground[at], np.empty((len(at), 2)), np.empty(len(at))
    for i in np.unique(camera).tolist():
        mine = camera == i
        lean[mine] = cameras[i].parallax(ground[mine])
        resolution[mine] = [cameras[i].image_from_row.scale_at(p) for p in ground[mine]]
    sigma = np.concatenate([s.sigma_px for s in seen])[at] / resolution
    points = FiducialPoints(row, ground, lean, flat[mark], sigma, resolution, number[mark], camera)
    found, fixture = {n for n in points.which.tolist() if n >= 0}, points.fixture_marks
    apart = set(board_type.apart_from_c(found, fixture))
    if board_type.board_of_c(found, fixture) is not None:
        # The board is displaced against the fixture, as it is against a fiducial of the panel.
        apart.add(FIXTURE)
    return replace(points, sigma_mm=np.where(np.isin(points.which, sorted(apart)), np.hypot(sigma, LOCAL_MM), sigma))


def match_nearest(
    board_mm: Floats, kind: Ints, ends: Ints, expected_mm: Floats, expected_kind: Ints, apart_mm: float
) -> tuple[Ints, Ints]:
    """Find for each of m marks, in each frame, the nearest detection of its kind that is closer than `apart_mm`.

    The k detections `board_mm` (k, 2), `kind` (k,) stand frame by frame; `ends` (f + 1,) are the index of the first one
    of each of f frames, and finally k. The marks are `expected_mm` (m, 2), `expected_kind` (m,). Returns the index of
    the detection (n,) and of the mark (n,) for n matches.
    """
    off = np.hypot(*np.moveaxis(board_mm[:, None] - expected_mm, 2, 0))
    off[kind[:, None] != expected_kind] = np.inf
    at, mark = np.nonzero(off < apart_mm)
    pair = np.searchsorted(ends, at, side="right") * len(expected_mm) + mark
    nearest = np.lexsort((off[at, mark], pair))
    nearest = nearest[np.diff(pair[nearest], prepend=-1) != 0]
    return at[nearest], mark[nearest]
