"""Plans: every cell has a frame, lost frames are replaced by others, and layers of HDR are planned together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.mosaic.conftest import PX_PER_MM, Film, Filmed
from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry import Lens, Projective, System, apply
from vaoi_station.mosaic import MosaicPlan, choose_frames, make_plan
from vaoi_station.mosaic.gains import FieldCache, Gains, survey
from vaoi_station.mosaic.plan import (
    CELL_PX,
    NO_FRAME,
    FrameCells,
    assign_cells,
    cell_shape,
    crossing_cost,
    disagreement,
    lock_bodies,
    sight_of,
)
from vaoi_station.photometry import FlatFields
from vaoi_station.steps import completed


def plan_of(board: Filmed, *, hdr: bool = False, fields: FlatFields | None = None) -> MosaicPlan:
    steps = make_plan(
        choose_frames(board.taken, hdr=hdr),
        board.read,
        projector=board.projector,
        board_type=board.board_type,
        stitch=board.stitch,
        base=board.base,
        fields=fields,
    )
    return completed(steps)


def test_every_cell_has_a_frame(board: Filmed) -> None:
    plan = plan_of(board)
    assert plan.covered == 1.0
    assert set(np.unique(plan.layers[0])) <= set(range(len(plan.frames)))
    assert plan.tone[0] < 100 / 250 < plan.tone[1]
    assert plan.cameras.keys() == {0, 1}


def test_lost_frames_are_replaced_by_their_neighbours(board: Filmed) -> None:
    lost = replace(board, frames={key: p for key, p in board.frames.items() if key[1] != 2})
    plan = plan_of(lost)
    assert plan.covered == 1.0
    assert all(frame.taken.row != 2 for frame in plan.frames)


def test_sight_is_that_of_every_cell_though_few_are_projected(film: Film) -> None:
    """The camera of this frame is tilted and rolled, and has a lens."""
    board = film()
    eye = board.cameras[1]
    matrix = eye.image_from_row.matrix @ np.array([[1, 0, 0], [0, 1, 0], [2e-5, -3e-5, 1]])
    bent = replace(
        eye, image_from_row=Projective(matrix, System.IMAGE, System.ROW), lens=Lens((159.5, 119.5), 200.0, (2e-3,))
    )
    projector = FrameIndex.of_result(board.stitch, (board.cameras[0], bent))
    sight = sight_of(board.taken[1], projector, board.base)
    h, w = sight.inside_px.shape
    y, x = np.mgrid[sight.y0 : sight.y0 + h, sight.x0 : sight.x0 + w]
    cad = apply(board.base.cad_from_mosaic, np.stack([x, y], -1) * float(CELL_PX) + (CELL_PX - 1) / 2)
    raw = projector.raw_px(1, 0, cad)
    room = np.minimum(raw, (eye.width_px - 1, eye.height_px - 1) - raw).min(-1)
    np.testing.assert_allclose(sight.inside_px, room, atol=0.1)
    np.testing.assert_allclose(sight.slant_mm, np.hypot(*projector.from_foot_mm(1, 0, cad).T).T, atol=0.02)


def test_body_is_taken_from_the_frame_that_sees_it_most_vertically(board: Filmed) -> None:
    sights = [sight_of(f, board.projector, board.base) for f in board.taken]
    cost = np.ones(cell_shape(board.base), np.float32)
    labels = completed(lock_bodies(board.board_type, board.stitch, sights, board.base, cost))
    x, y = (apply(board.base.mosaic_from_cad, (15, 14)) // CELL_PX).astype(int)
    patch = labels[y - 1 : y + 2, x - 1 : x + 2]
    assert len(np.unique(patch)) == 1
    assert cost[y, x] < 0.1
    slants = [
        float(np.hypot(*board.projector.from_foot_mm(f.camera, f.row, np.array((15.0, 14.0))))) for f in board.taken
    ]
    assert patch[1, 1] >= 0
    assert slants[patch[1, 1]] < min(slants) + 0.5


def test_a_body_that_does_not_follow_c_is_locked_where_it_lies(board: Filmed) -> None:
    sights = [sight_of(f, board.projector, board.base) for f in board.taken]
    right, shift = np.eye(3), 2 * CELL_PX / PX_PER_MM
    right[0, 2] = shift
    (c,) = (m for m in (board.stitch.cad_matrix,) if m is not None)
    own = {part.address: right @ c for part in board.board_type.components}
    usual, moved = (np.ones(cell_shape(board.base), np.float32) for _ in range(2))
    completed(lock_bodies(board.board_type, board.stitch, sights, board.base, usual))
    displaced = board.stitch.model_copy(update={"local_matrices": own})
    labels = completed(lock_bodies(board.board_type, displaced, sights, board.base, moved))
    np.testing.assert_array_equal(moved, np.roll(usual, 2, axis=1))
    assert (usual < 1).any()
    x, y = (apply(board.base.mosaic_from_cad, (15 + shift, 14)) // CELL_PX).astype(int)
    assert len(np.unique(labels[y - 1 : y + 2, x - 1 : x + 2])) == 1


def test_disagreement_shows_what_one_frame_alone_sees(board: Filmed) -> None:
    frames = dict(board.frames)
    frames[0, 2] = frames[0, 2].copy()
    frames[0, 2][100:140, 100:140] = 20
    found = list(
        survey(board.taken, lambda i, j: frames[i, j], board.projector, board.base, FieldCache(FlatFields.none()))
    )
    gains = Gains({}, {}, 0.0)
    differ = completed(disagreement(found, gains, board.projector, cell_shape(board.base)))
    cad = np.linalg.inv(board.stitch.image_matrices[0][2] @ board.stitch.cad_matrix)  # type: ignore[operator]
    x, y = (apply(board.base.mosaic_from_cad, apply(cad, (120.0, 120.0))) // CELL_PX).astype(int)
    assert differ[y, x] > 0.4
    assert np.median(differ) < 0.15
    assert crossing_cost(differ)[y, x] < 0.4


def two_frames(shape: tuple[int, int], width: int) -> FrameCells:
    """Two frames that overlap in the middle columns, each starting at its outer end."""
    h, w = shape
    box = np.array([(0, 0, width, h), (w - width, 0, width, h)], np.int32)
    start = np.array([0, width * h], np.int64)
    seed = np.array([(0, h // 2), (w - 1, h // 2)], np.int32)
    return FrameCells(box, start, np.ones(2 * width * h, bool), seed, np.zeros(2))


def test_every_cell_has_the_frame_whose_front_comes_first() -> None:
    """Compared with the shortest paths of each frame alone, by Bellman and Ford, over ground of random cost."""
    g = np.random.default_rng(1)
    cost = g.uniform(0.05, 1.0, (17, 29)).astype(np.float32)
    frames = two_frames((17, 29), 22)
    frames.delay[:] = 0.7, 3.1
    times = np.full((2, 17, 29), np.inf)
    for f, ((x, y), delay) in enumerate(zip(frames.seed.tolist(), frames.delay.tolist(), strict=True)):
        left = int(frames.box[f, 0])
        seen, price = times[f, :, left : left + 22], cost[:, left : left + 22].astype(float)
        seen[y, x - left] = delay
        for _ in range(seen.size):
            before = seen.copy()
            for dy, dx in np.ndindex(3, 3):
                a, b = (np.s_[max(d - 1, 0) : n + min(d - 1, 0)] for d, n in ((dy, 17), (dx, 22)))
                c, d = (np.s_[max(1 - d, 0) : n + min(1 - d, 0)] for d, n in ((dy, 17), (dx, 22)))
                way = np.hypot(dy - 1, dx - 1) / 2 * (price[a, b] + price[c, d])
                seen[a, b] = np.minimum(seen[a, b], before[c, d] + way)
            if (seen == before).all():
                break
    labels = completed(assign_cells(frames, cost, np.full((17, 29), NO_FRAME, np.int32)))
    np.testing.assert_array_equal(labels, times.argmin(0))


def test_locked_cells_keep_their_frame_and_cells_that_no_frame_shows_have_none() -> None:
    locked = np.full((9, 21), NO_FRAME, np.int32)
    locked[3:5, 8:10] = 1
    labels = completed(assign_cells(two_frames((9, 21), 8), np.ones((9, 21), np.float32), locked))
    assert (labels[3:5, 8:10] == 1).all()
    assert labels[0, 10] == NO_FRAME
