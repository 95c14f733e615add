"""Bodies in the picture of a region lie still: their edges stay steep, and the ground is as before."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np
import pytest

from tests.hdr.conftest import StitchedBoard
from vaoi_station.hdr import Exposed, merge_views
from vaoi_station.hdr.bodies import Body, bodies_in, merge_region, views_of_bodies
from vaoi_station.hdr.parts import region_component, views_on_top
from vaoi_station.photometry import FlatFields, NoiseModel, Taken
from vaoi_station.rendering import View, ViewCalculator

Expose = Callable[[Iterable[View]], list[Exposed]]


@pytest.fixture
def expose(small_board: StitchedBoard) -> Expose:
    recording, fields = small_board.recording, FlatFields.none(NoiseModel())

    def begin(views: Iterable[View]) -> list[Exposed]:
        return [
            Exposed(
                v,
                Taken(250.0),
                fields.maps(v.camera, None),
                (recording.head.cameras[v.camera].width, recording.head.cameras[v.camera].height),
                partial(recording.frame, v.camera, v.row),  # type: ignore[arg-type]  # no frame is missing
            )
            for v in views
        ]

    return begin


def inner(body: Body, picture: Any) -> Any:
    """Return the middle of a footprint in the picture of the region."""
    x0, y0, x1, y1 = body.box
    h, w = (y1 - y0) // 4, (x1 - x0) // 4
    return picture[y0 + h : y1 - h, x0 + w : x1 - w]


@pytest.mark.parametrize("ref", ["C1", "J2"])
def test_a_body_has_no_ghost_and_the_ground_stays(small_board: StitchedBoard, expose: Expose, ref: str) -> None:
    board_type, stitch = small_board.board_type, small_board.stitch
    part = board_type.component(ref)
    assert part is not None
    calculator = ViewCalculator(board_type, stitch, small_board.cameras)
    corners = board_type.footprint(part)
    # Neither the sides nor the place of the region are whole pixels.
    region = region_component((*(corners.min(0) - 1.03), *(corners.max(0) + 0.97)), board_type, 18.0)
    views = expose(views_on_top(calculator, region, 0.0))
    bodies = bodies_in(views[0].view, board_type, stitch)
    assert [b.height_mm for b in bodies] == sorted(b.height_mm for b in bodies)
    seen = [(b, expose(of)) for b, of in views_of_bodies(calculator, bodies, views[0].view.px_per_mm)]
    (body,) = (b for b in bodies if b.height_mm == pytest.approx(part.body_height, abs=0.05))
    before, after = merge_views(views, groups=False)[-1], merge_region(views, seen, groups=False)[-1]
    steep = [float(np.abs(np.gradient(inner(body, p.value), axis=0)).max()) for p in (before, after)]
    assert steep[1] > 1.2 * steep[0]
    (own,) = (merge_views(of, groups=False)[-1] for b, of in seen if b is body)
    x0, y0, x1, y1 = body.box
    assert own.value.shape == (y1 - y0, x1 - x0)
    np.testing.assert_array_equal(
        inner(body, after.value), inner(body._replace(box=(0, 0, x1 - x0, y1 - y0)), own.value)
    )
    covered = np.zeros(after.value.shape, bool)
    for b in bodies:
        covered[b.box[1] : b.box[3], b.box[0] : b.box[2]] = True
    np.testing.assert_array_equal(after.value[~covered], before.value[~covered])


def test_each_picture_shows_bodies_by_its_own_frames(small_board: StitchedBoard, expose: Expose) -> None:
    """The body of a picture of one frame is that of this frame."""
    board_type = small_board.board_type
    calculator = ViewCalculator(board_type, small_board.stitch, small_board.cameras)
    part = board_type.component("C1")
    assert part is not None
    corners = board_type.footprint(part)
    views = views_on_top(calculator, region_component((*corners.min(0), *corners.max(0)), board_type, 18.0), 0.0)
    bodies = bodies_in(views[0], board_type, small_board.stitch)
    seen = [(b, expose(of)) for b, of in views_of_bodies(calculator, bodies, views[0].px_per_mm)]
    single = merge_region(expose(views[:1]), seen, groups=False)[-1]
    body, of = seen[-1]
    (mine,) = (e for e in of if e.key == (views[0].camera, views[0].row))
    alone = merge_views([mine], groups=False)[-1].value
    found, expected = (
        inner(b, v) for b, v in ((body, single.value), (body._replace(box=(0, 0, *alone.shape[::-1])), alone))
    )
    shown = np.isfinite(expected)
    assert shown.any()
    np.testing.assert_array_equal(found[shown], expected[shown])
