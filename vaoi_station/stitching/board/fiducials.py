"""Assignment of detections to the board's fiducials, which gives a first C (paper, section 3.3.4).

Handedness follows from board type and cameras, never from the detections. The fiducials are the set of detections whose
distances, direction and scores fit the CAD data best. If the outline is known, linked texture must lie inside it.

Detection of places in a frame that look like a fiducial or a fixture mark of the board type.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

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
from vaoi_station.stitching.adjustment.motion import Motion, points_in_box
from vaoi_station.stitching.adjustment.problem import FIXTURE, FiducialPoints
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.expectation import Expectation
from vaoi_station.stitching.matching.evidence import Detections, FrameKey, Task
from vaoi_station.stitching.matching.frames import PreparedFrame, Scene, downsampled

_MOST_PER_FRAME, _MOST_WHEN_LOST = 12, 80
BOARD_MM = 1.2
"""Largest distance of a fiducial of a board of a panel from the place that the first C gives it."""
_UNLIKE_MM, _NEARER, _TURN_RAD = 0.25, 0.1, np.radians(1.5)
"""Limits of a pair of candidates of one board: difference of their distance from that of the fiducials, share of the
displacement that is added to it, and turn."""
_SMALL = 1.12
"""Factor on a mark's size before the reduction of the frame is chosen.

With it, cameras of similar resolution get the same reduction."""


def mark_kinds(board_type: BoardType) -> tuple[tuple[Shape, float], ...]:
    """List the kinds (shape, size in mm) of a board type's fiducials, each once, in order of appearance."""
    return tuple(dict.fromkeys(kind_of(f, board_type) for f in board_type.fiducials))


def kind_of(fiducial: Fiducial, board_type: BoardType) -> tuple[Shape, float]:
    """Return the kind of a fiducial: its shape and its size in mm."""
    return fiducial.shape, round(fiducial.diameter * board_type.mm_per_unit, 6)


def fixture_kind(board_type: BoardType) -> tuple[Shape, float] | None:
    """Return the kind (shape, size in mm) of the fixture marks; None if the board type has none.

    Among the kinds, that of the fixture marks has the index after the last one of `mark_kinds`.
    """
    mark = board_type.fixture_mark
    if mark is None or not board_type.fixture_marks:
        return None
    return mark.shape, round(mark.size * board_type.mm_per_unit, 6)


def detect_marks(
    task: Task,
    frame: PreparedFrame,
    camera: Camera,
    board_type: BoardType | None,
    *,
    fixture: bool = False,
    most: int = _MOST_PER_FRAME,
) -> Detections:
    """Detect the places of a frame that look most like fiducials of the board type.

    Args:
        task: the task to which the detections belong.
        frame: the frame.
        camera: camera of the frame.
        board_type: board type whose fiducials are searched; None gives no detections.
        fixture: whether fixture marks are searched too.
        most: largest number of detections per kind.
    """
    found: list[tuple[Mark, int]] = []
    kinds = list(mark_kinds(board_type)) if board_type else []
    own = fixture_kind(board_type) if board_type and fixture else None
    for kind, (shape, size_mm) in enumerate([*kinds, own] if own else kinds):
        size_px = size_mm * camera.px_per_mm
        rough = _search_kind(frame, shape, size_px, most)
        marks: Iterable[Mark | Failure] = rough
        # `relocate_fiducials` locates fiducials precisely later. Fixture marks are located precisely here.
        if kind == len(kinds):
            marks = (locate_mark(frame.grey, mark.px, shape, size_px) for mark in rough)
        found += [(mark, kind) for mark in marks if isinstance(mark, Mark)]
    return Detections(
        task,
        np.array([m.px for m, _ in found]).reshape(-1, 2),
        np.array([m.sigma_px for m, _ in found]),
        np.array([m.score for m, _ in found]),
        np.array([k for _, k in found], dtype=np.int_),
    )


def _search_kind(frame: PreparedFrame, shape: Shape, size_px: float, most: int) -> list[Mark]:
    """Search marks of one kind in a reduced frame, and locate them in the same frame at twice that resolution.

    A mark is about 5 to 9 px wide in the frame that is searched.
    """
    # This is accurate to some hundredths of a pixel, enough for a first C, and reads a few hundred pixels per mark.
    coarse = reduction_factor(_SMALL * size_px)
    fine = max(coarse // 2, 1)
    places, _ = find_candidates(downsampled(frame, coarse), shape, size_px / coarse, most)
    medium = downsampled(frame, fine) if len(places) else None
    marks = []
    for place in (places + 0.5) * (coarse / fine) - 0.5:
        assert medium is not None
        mark = locate_mark(medium, place, shape, size_px / fine, precise=False)
        if isinstance(mark, Mark):
            marks.append(replace(mark, px=(mark.px + 0.5) * fine - 0.5, sigma_px=mark.sigma_px * fine))
    return marks


def detect_more_marks(
    board_type: BoardType, scene: Scene, detections: Sequence[Detections], *, fixture: bool
) -> list[Detections]:
    """Search the frames of the given detections again, with a larger limit on the number of detections per frame."""
    return [
        detect_marks(
            s.task,
            scene.prepared(s.task.a),
            scene.cameras[s.task.a[0]],
            board_type,
            fixture=fixture,
            most=_MOST_WHEN_LOST,
        )
        for s in detections
    ]


def displaced_places(board_type: BoardType, places: Floats, mm: Floats, kind: NDArray[np.int_]) -> Floats:
    """Return the predicted places (k, 2) of fiducials, those of a panel's boards displaced as their candidates show.

    The pair of candidates that fits the distance of two fiducials best shows shift and turn of their board.

    Args:
        board_type: the board type.
        places: (k, 2) places of the fiducials by a first C, tester coordinates.
        mm: (n, 2) candidates, tester coordinates.
        kind: (n,) their kinds.
    """
    kinds, out = mark_kinds(board_type), places.copy()
    for position, numbers in board_type.board_fiducials.items():
        of = [np.flatnonzero(kind == kinds.index(kind_of(board_type.fiducials[n], board_type))) for n in numbers]
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


def relocate_fiducials(
    board_type: BoardType, places_mm: Floats, scene: Scene, motion: Motion, detections: Sequence[Detections]
) -> list[Detections]:
    """Locate precisely each fiducial that a frame must show; all other detections are returned unchanged.

    The predicted places (k, 2) of the fiducials, tester coordinates, show where each lies in a frame. Only this place
    is searched. So a fiducial is found even in frames whose short list of detections did not contain it.
    """
    kinds = mark_kinds(board_type)
    kind = [kinds.index(kind_of(f, board_type)) for f in board_type.fiducials]
    expected = _in_view(places_mm, scene, motion)
    return [_relocated(s, expected[s.task.a], kind, kinds, scene) if s.task.a in expected else s for s in detections]


def _in_view(board: Floats, scene: Scene, motion: Motion) -> dict[FrameKey, list[tuple[int, Floats]]]:
    """List for each frame which of the board points (k, 2) it shows: index of the point, and its raw pixels (2,)."""
    out: dict[FrameKey, list[tuple[int, Floats]]] = {}
    for number, camera in enumerate(scene.cameras):
        row, point, place = points_in_box(motion.rows_from_tester, board, *camera.view_mm())
        px = camera.project(place)
        for n in np.flatnonzero(camera.sees(px)):
            out.setdefault((number, int(row[n])), []).append((int(point[n]), px[n]))
    return out


def _relocated(
    s: Detections,
    expected: Sequence[tuple[int, Floats]],
    kind: Sequence[int],
    kinds: Sequence[tuple[Shape, float]],
    scene: Scene,
) -> Detections:
    """Locate the fiducials that are expected in one frame, and replace their detections.

    Args:
        s: detections of the frame.
        expected: index and expected raw pixels of each fiducial in the frame.
        kind: index of each fiducial's kind.
        kinds: the kinds.
        scene: cameras and frames.
    """
    grey, px_per_mm = scene.prepared(s.task.a).grey, scene.cameras[s.task.a[0]].px_per_mm
    for n, px in expected:
        shape, size_mm = kinds[kind[n]]
        size_px = size_mm * px_per_mm
        near = np.hypot(*(s.px - px).T) < size_px / 3
        # The search starts at a detection if there is one: C from two fiducials may be off by some pixels far from
        # these.
        start = s.px[near][s.score[near].argmax()] if near.any() else px
        mark = locate_mark(grey, start, shape, size_px)
        if isinstance(mark, Mark):
            s = _with(s, ~near, mark, kind[n])
    return s


def _with(s: Detections, keep: NDArray[np.bool_], mark: Mark, kind: int) -> Detections:
    """Return the detections for which `keep` is true, with `mark` added as a further detection."""
    return Detections(
        s.task,
        np.vstack([s.px[keep], mark.px]),
        np.append(s.sigma_px[keep], mark.sigma_px),
        np.append(s.score[keep], mark.score),
        np.append(s.kind[keep], kind).astype(np.int_),
    )


_SAME_PLACE_MM = 0.4
LOCAL_MM = 0.5
"""Standard deviation against C of fiducials that have no part in it: they state where components are, or a board of a
panel."""
_SCALE_SIGMA = 1.0e-3
_SCORE_SIGMA = 0.02
_TEXTURE_MARGIN_MM = 1.0
_MOST_OUTSIDE = 0.25
"""Largest share of textured points off the board. If more lie there, C is rejected."""
_SCALE_LIMIT = 4e-3
_ROUGH_FACTOR, _MOST_PLACES = 4.0, 6
"""Limits while the motion of the board is uncertain.

The first is a factor on the limits of the scale of C and of the distance between a fiducial and its candidate. The
second is the largest number of positions of the board that are tried."""
_SLACK_MM = 0.15
_MOST_PAIRS, _MOST_OWN_PAIRS = 24, 200
"""Largest number of pairs of fiducials that are tried: of a panel's boards, and of the board or panel itself."""


@dataclass(frozen=True, eq=False)
class FiducialCandidates:
    """k candidates: each is the position of a possible mark on the board, merged from the detections in several frames.

    Position `mm` (k, 2) in tester coordinates, kind (k,) and score (k,).
    """

    mm: Floats
    kind: NDArray[np.int_]
    score: Floats


def merge_detections(detections: Sequence[Detections], cameras: Sequence[Camera], motion: Motion) -> FiducialCandidates:
    """Merge detections of the same mark in several frames into one candidate: the detection with the best score."""
    mm, kind, score = (np.zeros((0, 2)), np.zeros(0, dtype=np.int_), np.zeros(0))
    seen = [s for s in detections if len(s.px)]
    if seen:
        _, _, mm = _to_board(seen, cameras, motion)
        kind, score = np.concatenate([s.kind for s in seen]), np.concatenate([s.score for s in seen])
    # Detections are sorted by score, best first: of several close together, only the first is kept.
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
    """Select distinct points: return for each of k points whether it is kept.

    A point is dropped if an earlier kept point of the same kind lies closer than `apart_mm`.
    """
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
    """Numbers of the fiducials for which this C finds a detection."""
    ambiguous: bool = False
    """Whether the board turned by 180° fits equally well and the pictures do not decide."""


def find_board(
    plane: BoardPlane, places: FiducialCandidates, angle_rad: float, expectation: Expectation, texture_mm: Floats
) -> Hypothesis | Failure:
    """Find the similarity under which the detections fit the board's fiducials at the least cost.

    Args:
        plane: plane of the board type.
        places: candidates on the board.
        angle_rad: expected direction of the flat x axis, in tester coordinates.
        expectation: expected position of the board, and tolerances.
        texture_mm: (k, 2) linked points, which should lie on the board.
    """
    # Two points define a similarity. Each pair of fiducials is tried on each pair of candidates at the same distance.
    board_type, flat = plane.board_type, plane.fiducials
    if len(flat) < 2:
        few = f"board type {board_type.name!r} has {len(flat)} fiducials; two are needed for the CAD mapping"
        return Failure(few, ReasonCode.TOO_FEW_FIDUCIALS)
    kinds = [mark_kinds(board_type).index(kind_of(f, board_type)) for f in board_type.fiducials]
    best: Hypothesis | None = None
    nearest: tuple[float, str] = (np.inf, "")
    for i, j in _pairs_to_try(plane):
        for c, pair in _similarities_of_pairs(flat[i], flat[j], places, kinds[i], kinds[j], board_type.mm_per_unit):
            turn = _wrapped(float(np.arctan2(c[1], c[0])) - angle_rad)
            scale = float(np.hypot(c[0], c[1])) / board_type.mm_per_unit - 1
            off = max(abs(turn) / expectation.angle_tolerance_rad, abs(scale) / _SCALE_LIMIT)
            if off > 1:
                what = f"turned by {np.degrees(turn):.1f}°, scale off by {scale:.2%}"
                # This text is used in the message of a failure only. It shows the engineer what was nearly accepted.
                nearest = min(nearest, (off, what))
                continue
            cost, used = _score_cost(plane, c, places, kinds, pair, (i, j))
            cost += (scale / _SCALE_SIGMA) ** 2 + (2 * turn / expectation.angle_tolerance_rad) ** 2
            cost += _place_score_cost(plane, c, texture_mm, expectation)
            if np.isfinite(cost) and (best is None or cost < best.cost):
                best = Hypothesis(c, cost, used)
    if best is not None:
        return best
    seen = f"{len(places.mm)} place(s) look like fiducials"
    hint = f"; the nearest fit is {nearest[1]}" if nearest[1] else ""
    nowhere = f"the fiducials of {board_type.name!r} are not where they should be: {seen}, no pair fits{hint}"
    todo = "compare fiducials, expected position and angle with the board"
    return Failure(f"{nowhere}; {todo}", ReasonCode.FIDUCIALS_NOT_FOUND)


def _pairs_to_try(plane: BoardPlane) -> list[tuple[int, int]]:
    """List the pairs of fiducials that may locate the board: if there are many, those farthest apart.

    A long pair shows scale and turn best. A panel of 20 boards has 780 pairs, and trying all would take seconds. Its
    boards are displaced, so that pairs of them are the last resort. A grid of 60 fiducials has 1,770 pairs, each of
    which fits it in dozens of places.
    """
    of_boards = {n for numbers in plane.board_type.board_fiducials.values() for n in numbers}
    every = list(combinations(range(len(plane.fiducials)), 2))
    if len(every) > _MOST_PAIRS:
        every.sort(key=lambda pair: -math.dist(*plane.fiducials[list(pair)]))
    panel = [pair for pair in every if not of_boards.intersection(pair)]
    others = [pair for pair in every if of_boards.intersection(pair)]
    return panel[:_MOST_OWN_PAIRS] + others[:_MOST_PAIRS]


def find_rough_places(
    plane: BoardPlane, places: FiducialCandidates, angle_rad: float, expectation: Expectation
) -> list[Hypothesis]:
    """List the positions of the board that the detections allow while the motion is uncertain, most likely first.

    The motion may have been estimated from texture beside the board, at another height. The scale along the motion is
    then wrong by up to 1 %. Texture outside the board is therefore no argument against a position here.
    """
    flat, found = plane.fiducials, []
    kinds = [mark_kinds(plane.board_type).index(kind_of(f, plane.board_type)) for f in plane.board_type.fiducials]
    mm_per_unit, limit = plane.board_type.mm_per_unit, _ROUGH_FACTOR * _SCALE_LIMIT
    for i, j in _pairs_to_try(plane):
        ends = (flat[i], flat[j])
        for c, pair in _similarities_of_pairs(*ends, places, kinds[i], kinds[j], mm_per_unit, limit):
            turn = _wrapped(float(np.arctan2(c[1], c[0])) - angle_rad)
            scale = float(np.hypot(c[0], c[1])) / mm_per_unit - 1
            if abs(turn) > expectation.angle_tolerance_rad or abs(scale) > limit:
                continue
            cost, used = _score_cost(plane, c, places, kinds, pair, (i, j), _ROUGH_FACTOR * _SAME_PLACE_MM)
            cost += (scale / (_ROUGH_FACTOR * _SCALE_SIGMA)) ** 2 + (2 * turn / expectation.angle_tolerance_rad) ** 2
            found.append(Hypothesis(c, cost + _place_score_cost(plane, c, np.zeros((0, 2)), expectation), used))
    found.sort(key=lambda h: h.cost)
    kept: list[Hypothesis] = []
    middle = flat.mean(0)[None] if len(flat) else np.zeros((1, 2))
    for h in found:
        at = apply_similarity(h.c, middle)[0]
        if all(np.hypot(*(apply_similarity(k.c, middle)[0] - at)) > 2 * _SAME_PLACE_MM for k in kept):
            kept.append(h)
        if len(kept) == _MOST_PLACES:
            break
    return kept


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
    board_type = plane.board_type
    kinds = [mark_kinds(board_type).index(kind_of(f, board_type)) for f in board_type.fiducials]
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


@compiled
def match_nearest(
    board_mm: Floats,
    kind: NDArray[np.int_],
    ends: NDArray[np.int_],
    expected_mm: Floats,
    expected_kind: NDArray[np.int_],
    apart_mm: float,
) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Match marks to detections: find for each mark, in each frame, the nearest detection of the same kind.

    Args:
        board_mm: (k, 2) board points of the k detections, frame by frame.
        kind: (k,) kind of each detection.
        ends: (f + 1,) for f frames: index of the first detection of each frame, and finally k.
        expected_mm: (m, 2) expected board points of the m marks.
        expected_kind: (m,) kind of each mark.
        apart_mm: matches are closer than this.

    Returns:
        For n matches, the index of the detection (n,) and the index of the mark (n,).
    """
    most = (len(ends) - 1) * len(expected_mm)
    seen, mark, count = np.empty(most, np.int64), np.empty(most, np.int64), 0
    for f in range(len(ends) - 1):
        for m in range(len(expected_mm)):
            nearest, least = -1, apart_mm
            for k in range(ends[f], ends[f + 1]):
                off = math.hypot(board_mm[k, 0] - expected_mm[m, 0], board_mm[k, 1] - expected_mm[m, 1])
                if kind[k] == expected_kind[m] and off < least:
                    nearest, least = k, off
            if nearest >= 0:
                seen[count], mark[count], count = nearest, m, count + 1
    return seen[:count].copy(), mark[:count].copy()


def _similarities_of_pairs(
    f: Floats,
    g: Floats,
    places: FiducialCandidates,
    kind_f: int,
    kind_g: int,
    mm_per_unit: float,
    scale_limit: float = _SCALE_LIMIT,
) -> list[tuple[Floats, tuple[int, int]]]:
    """List pairs of candidates as far apart as two fiducials, each with the similarity that it defines.

    `f` and `g` are the flat coordinates (2,) of the fiducials; `kind_f` and `kind_g` are their kinds.
    """
    of, og = np.flatnonzero(places.kind == kind_f), np.flatnonzero(places.kind == kind_g)
    if not len(of) or not len(og):
        return []
    to = complex(*(g - f))
    arrow = (places.mm[og][None, :] - places.mm[of][:, None]) @ np.array([1, 1j])
    slack = 2 * scale_limit * abs(to) * mm_per_unit + _SLACK_MM
    near = np.abs(np.abs(arrow) - abs(to) * mm_per_unit) <= slack
    out = []
    for k, n in np.argwhere(near):
        turn = complex(arrow[k, n]) / to
        shift = complex(*places.mm[of[k]]) - turn * complex(*f)
        out.append((np.array([turn.real, turn.imag, shift.real, shift.imag]), (int(of[k]), int(og[n]))))
    return out


def _score_cost(
    plane: BoardPlane,
    c: Floats,
    places: FiducialCandidates,
    kinds: list[int],
    pair: tuple[int, int],
    chosen: tuple[int, int],
    near_mm: float = _SAME_PLACE_MM,
) -> tuple[float, tuple[int, ...]]:
    """Compute the cost of a given C from the candidates near its fiducials; return it with the matched fiducials.

    An unmatched fiducial costs a fixed amount, as much as a poor match.

    Args:
        plane: plane of the board type.
        c: parameters (a, b, x, y) of C.
        places: candidates on the board.
        kinds: kind of each fiducial.
        pair: the two candidates that define C.
        chosen: the two fiducials that belong to them.
        near_mm: a candidate nearer to the place of a fiducial than this is matched to it.
    """
    expected = apply_similarity(c, plane.fiducials)
    cost, used = 0.0, []
    for f, at in enumerate(expected):
        if f in chosen:
            k = pair[chosen.index(f)]
            cost += ((1 - places.score[k]) / _SCORE_SIGMA) ** 2
            used.append(f)
            continue
        distance = np.where(places.kind == kinds[f], np.hypot(*(places.mm - at).T), np.inf)
        k = int(distance.argmin())
        if distance[k] < near_mm:
            cost += ((1 - places.score[k]) / _SCORE_SIGMA) ** 2
            used.append(f)
        else:
            cost += 50.0
    return cost, tuple(used)


def outside_share(plane: BoardPlane, c: Floats, texture_mm: Floats) -> float:
    """Compute the share of textured points outside the board for a given C; 0 without outline or with fixture marks."""
    board_type = plane.board_type
    # A fixture has texture beside the board, so texture there is no sign of a wrong C.
    if board_type.outline is None or board_type.fixture_marks or not len(texture_mm):
        return 0.0
    low, high = board_type.extent()
    margin = _TEXTURE_MARGIN_MM / board_type.mm_per_unit
    cad_from_board = np.linalg.inv(plane.matrix(c)).astype(np.float64)
    return _outside(cad_from_board, texture_mm, low - margin, high + margin) / len(texture_mm)


@compiled
def _outside(cad_from_board: Floats, board_mm: Floats, low: Floats, high: Floats) -> int:
    """Count the board points (k, 2) outside a CAD box; `cad_from_board` (3, 3) is the affine map to CAD coordinates."""
    count, m = 0, cad_from_board
    for n in range(len(board_mm)):
        x = m[0, 0] * board_mm[n, 0] + m[0, 1] * board_mm[n, 1] + m[0, 2]
        y = m[1, 0] * board_mm[n, 0] + m[1, 1] * board_mm[n, 1] + m[1, 2]
        count += x < low[0] or x > high[0] or y < low[1] or y > high[1]
    return count


def _place_score_cost(plane: BoardPlane, c: Floats, texture_mm: Floats, expectation: Expectation) -> float:
    """Return the cost of texture outside the board plus the cost of the board's distance from its expected position."""
    outside = outside_share(plane, c, texture_mm)
    if outside > _MOST_OUTSIDE:
        return np.inf
    cost = 400.0 * max(outside - 0.02, 0.0)
    low, high = plane.board_type.extent()
    corners = plane.flat(np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]]))
    corner = apply_similarity(c, corners).min(0)
    for at, expected in zip(corner, expectation.corner_mm, strict=True):
        if expected is not None:
            cost += ((float(at) - expected) / expectation.tolerance_mm) ** 2
    return cost


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)
