"""Which frames a tile needs, where each of them has a weight, and how wide the parts of a large picture are."""

from __future__ import annotations

from tests.mosaic.conftest import Filmed
from tests.mosaic.test_plan import plan_of
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


def test_parts_of_a_large_picture_are_whole_tiles(board: Filmed) -> None:
    renderer = TileRenderer(plan_of(board), board.projector, board.base)
    assert renderer.block_px[0] in (256, 512, 1024, 2048, 4096)
    wide = TileRenderer(plan_of(board, hdr=True), board.projector, board.base)
    assert wide.block_px[0] <= 1024


def test_parts_are_high_where_one_has_the_whole_width(board: Filmed) -> None:
    """The board of 520 × 400 px is one part, but not with HDR, where a part has at most 1024 × 256 px."""
    assert TileRenderer(plan_of(board), board.projector, board.base).block_px[1] >= 400
    assert TileRenderer(plan_of(board, hdr=True), board.projector, board.base).block_px[1] <= 512
