"""Which frames a tile needs, where each of them has a weight, and how wide the parts of a large picture are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.mosaic.conftest import BOARD_MM, Filmed
from tests.mosaic.test_plan import plan_of
from vaoi_station.mosaic.plan import MosaicPlan, RaisedBody
from vaoi_station.mosaic.tile_specs import TileRenderer


def test_parts_are_the_frames_of_the_cells_of_a_tile(board: Filmed) -> None:
    plan = plan_of(board)
    renderer = TileRenderer(plan, board.projector, board.base)
    spec = renderer.spec((64, 64, 320, 192))
    assert (spec.width, spec.height) == (256, 128)
    labels = plan.layers[0][4:12, 4:20]
    shown = {plan.frames[n].taken[:2] for n in set(labels.ravel().tolist()) if n >= 0}
    assert shown <= {(part.camera, part.row) for part in spec.parts}
    for part in spec.parts:
        x0, y0, x1, y1 = part.crop
        assert x1 > x0
        assert y1 > y0


@pytest.mark.parametrize("factor", [1, 8])
def test_parts_hold_only_the_cells_of_their_frames(board: Filmed, factor: int) -> None:
    """All cells of a board in every part of its overview took 2 GB for 400 frames."""
    plan, grid = plan_of(board), board.base.reduced(factor)
    spec = TileRenderer(plan, board.projector, grid).spec((0, 0, grid.width, grid.height))
    numbers = {frame.taken[:2]: n for n, frame in enumerate(plan.frames)}
    found = np.full(spec.cell_shape, -1)
    for part in spec.parts:
        x0, y0, x1, y1 = part.cells
        assert part.mine is not None
        assert part.factor.shape == part.mine.shape == (y1 - y0, x1 - x0)
        found[y0:y1, x0:x1][part.mine > 0] = numbers[part.camera, part.row]
    np.testing.assert_array_equal(found, plan.layers[0])
    assert sum(part.factor.size for part in spec.parts) < 2 * found.size


def test_parts_of_a_large_picture_are_whole_tiles(board: Filmed) -> None:
    renderer = TileRenderer(plan_of(board), board.projector, board.base)
    assert renderer.block_px[0] in (256, 512, 1024, 2048, 4096)
    wide = TileRenderer(plan_of(board, hdr=True), board.projector, board.base)
    assert wide.block_px[0] <= 1024


def test_parts_are_high_where_one_has_the_whole_width(board: Filmed) -> None:
    """The board of 520 × 400 px is one part, but not with HDR, where a part has at most 1024 × 256 px."""
    assert TileRenderer(plan_of(board), board.projector, board.base).block_px[1] >= 400
    assert TileRenderer(plan_of(board, hdr=True), board.projector, board.base).block_px[1] <= 512


def crowded(board: Filmed, height_mm: float) -> MosaicPlan:
    """Plan the board with 3,100 bodies of 0.6 × 0.3 mm; of each hundred the last is twice as high."""
    at = np.random.default_rng(1).uniform((1, 1), np.array(BOARD_MM) - 1, (3100, 2))
    box = np.array([(-0.3, -0.15), (0.3, -0.15), (0.3, 0.15), (-0.3, 0.15)])
    bodies = [RaisedBody(box + p, height_mm * (2 if n % 100 == 99 else 1)) for n, p in enumerate(at)]
    return replace(plan_of(board, hdr=True), bodies=tuple(sorted(bodies, key=lambda body: body.height_mm)))


def test_an_overview_shows_only_bodies_that_their_heights_displace(board: Filmed) -> None:
    """The cameras are 300 mm above the board and see it up to 20 mm off their feet: 0.33 mm lean by 0.022 mm."""
    lean = board.projector.largest_lean(0)
    assert lean == pytest.approx(np.hypot(16, 12) / 300, rel=0.05)
    plan, base = crowded(board, 0.1 / lean / 10.0), board.base
    counts = {}
    for factor in (1, 2, 4, 8):
        grid = base.reduced(factor)
        box = (0, 0, min(grid.width, 256), min(grid.height, 256))
        spec = TileRenderer(plan, board.projector, grid).spec(box)
        counts[factor] = len(spec.bodies)
        assert len(spec.bodies) <= box[2] * box[3] / 256
    # At full resolution all are displaced enough, and the highest of the tile are taken; at half, the higher ones.
    assert counts == {1: 256, 2: 31, 4: 0, 8: 0}


def test_bodies_of_less_than_a_pixel_are_part_of_the_ground(board: Filmed) -> None:
    plan = crowded(board, 50.0)
    sizes = [
        len(TileRenderer(plan, board.projector, board.base.reduced(f)).spec((0, 0, 32, 25)).bodies) for f in (1, 16)
    ]
    assert sizes == [3, 0]
