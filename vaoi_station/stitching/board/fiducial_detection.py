"""Detection of places in a frame that look like a fiducial or a fixture mark of the board type."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks import Mark, find_candidates, locate_mark
from vaoi_station.marks.candidate_search import reduction_factor
from vaoi_station.marks.mark_shape import Shape
from vaoi_station.model import BoardType, Fiducial
from vaoi_station.stitching.adjustment.motion import Motion, points_in_box
from vaoi_station.stitching.matching.evidence import Detections, FrameKey, Task
from vaoi_station.stitching.matching.prepared_frame import PreparedFrame, downsampled
from vaoi_station.stitching.matching.scene import Scene

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
