"""Bodies in the picture of a region lie still: their edges stay steep, and the ground is as before."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np
import pytest

from tests.hdr.conftest import StitchedBoard
from tests.hdr.exposed_views import FRAME, SIZE, exposed, scene, view, wanted
from vaoi_station.errors import InputError
from vaoi_station.hdr.merging import (
    Body,
    Exposed,
    bodies_in,
    exposure_groups,
    merge_region,
    merge_views,
    region_component,
    views_of_bodies,
    views_on_top,
)
from vaoi_station.model import BoardType, Component
from vaoi_station.photometry import FieldMaps, FlatFields, NoiseModel, Taken
from vaoi_station.rendering import View, ViewCalculator
from vaoi_station.rendering.views import Tile


def keys(groups: list[list[Exposed]]) -> list[list[tuple[int, int]]]:
    return [[(v.view.camera, v.view.row) for v in group] for group in groups]


@pytest.mark.parametrize("wide", [False, True])
def test_radiance_over_two_decades_has_an_honest_sigma(wide: bool) -> None:
    views = [exposed(c, r, 250.0 if c % 2 else 15.0, wide=wide) for r in (0, 1) for c in (0, 1)]
    *_, whole = merge_views(views)
    assert whole.exposures == 2
    assert whole.holes == 0
    assert [(v.camera, v.row) for v in whole.views] == [(0, 0), (1, 0), (0, 1), (1, 1)]
    z = (whole.value - wanted()) / whole.sigma
    assert 0.9 < float(np.sqrt((z**2).mean())) < 1.1
    blocks = (whole.value / wanted() - 1).reshape(6, 8, -1).mean((0, 1))
    assert float(np.sqrt((blocks**2).mean())) < 0.02
    assert np.isfinite(whole.value).all()


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("part_px", [0.0, 0.25, 0.5])
def test_sigma_is_honest_at_every_fraction_of_a_pixel(part_px: float, turned: bool) -> None:
    """Sharpening amplifies noise, and interpolation between pixels reduces it; also if the frame is turned."""
    even, found = np.full_like(scene(), 0.6), []
    for row in range(6):
        frame = exposed(0, row, 200.0, shift=(12.0, 9.0), radiance=even)
        x, y = 12.0 + part_px, 9.0 + part_px
        frame.view.matrix = np.array(
            [[0, 1, x], [-1, 0, y + 60], [0, 0, 1.0]] if turned else [[1, 0, x], [0, 1, y], [0, 0, 1.0]]
        )
        found.append(merge_views([frame])[-1])
    z = np.stack([(picture.value - 0.6) / picture.sigma for picture in found])
    z = z[np.isfinite(z)]
    assert len(z) > 10_000
    assert float(np.sqrt((z**2).mean())) == pytest.approx(1.0, abs=0.1)


def test_one_saturated_channel_of_colour_is_no_radiance() -> None:
    """Luminance of red metal is far from full scale where its red channel is saturated."""

    def frame(row: int, exposure_us: float) -> Exposed:
        grey = np.array([1.0, 1.0, 8.0]) * exposure_us + 2
        pixels = np.tile(np.clip(np.round(grey), 0, 255).astype(np.uint8), (FRAME[1], FRAME[0], 1))
        return Exposed(view(0, row, (12.0, 9.0)), Taken(exposure_us), maps, FRAME, lambda: pixels)

    maps = FieldMaps(None, 2.0, NoiseModel(1.5, 0.03))
    assert merge_views([frame(0, 100.0)])[-1].holes == 1
    short, both = merge_views([frame(0, 10.0)])[-1], merge_views([frame(0, 100.0), frame(1, 10.0)])[-1]
    np.testing.assert_allclose(short.value, 0.114 + 0.587 + 0.299 * 8, rtol=0.02)
    np.testing.assert_array_equal(both.value, short.value)


def test_saturated_pixels_and_their_neighbours_come_from_the_short_exposure() -> None:
    radiance = np.full_like(scene(), 0.3)
    radiance[40, 50] = 5.0
    long, short = exposed(0, 0, 250.0, radiance=radiance), exposed(1, 0, 15.0, radiance=radiance)
    alone = merge_views([long])[-1]
    hole = np.argwhere(np.isnan(alone.value))
    assert (hole.min(0) <= (19, 29)).all()
    assert (hole.max(0) >= (21, 31)).all()
    assert 9 <= len(hole) <= 25
    assert np.isinf(alone.sigma[20, 30])
    assert alone.exposures == 1
    both = merge_views([long, short])[-1]
    assert both.holes == 0
    assert both.value[20, 30] > 4
    assert both.value[19, 29] == pytest.approx(0.3, abs=0.25)


def test_exposures_in_turn_give_one_picture_for_each_run_of_rows_with_all_exposures() -> None:
    views = [exposed(0, r, 15.0 if r % 2 else 250.0) for r in range(5)]
    # A group has the longest exposure twice, where it can.
    assert keys(exposure_groups(views)) == [[(0, 0), (0, 1), (0, 2)], [(0, 1), (0, 2), (0, 3), (0, 4)], [
        (0, 2), (0, 3), (0, 4)
    ]]  # fmt: skip


def test_colour_and_tiles_of_a_distorted_view() -> None:
    plain = exposed(0, 0, 50.0)
    colour = np.repeat(plain.pixels()[:, :, None], 3, 2)
    w, h = SIZE
    split = view(0, 0, (12.0, 9.0))
    split.tiles = tuple(
        Tile(x0, 0, x1, h, np.array([[1, 0, 12.0 + x0], [0, 1, 9.0], [0, 0, 1]])) for x0, x1 in ((0, 25), (25, w))
    )
    found = merge_views([Exposed(split, plain.taken, plain.maps, FRAME, lambda: colour)])[-1]
    np.testing.assert_allclose(found.value, merge_views([plain])[-1].value, rtol=1e-4, atol=1e-4)


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


def board(**options: Any) -> BoardType:
    data = {"name": "b", "outline": [[0, 0], [40, 30]], "fiducials": []}
    return BoardType.model_validate(data | options)


@pytest.mark.parametrize(
    ("corners", "px_per_mm", "message"),
    [
        ((5, 5, 5, 9), 40.0, "X0 Y0 X1 Y1 is '5 5 5 9', but must be numbers with X0 < X1 and Y0 < Y1"),
        ((5, 5, float("nan"), 9), 40.0, "X0 < X1"),
        ((41, 5, 50, 9), 40.0, r"must be on the board, which reaches from 0 0 to 40 30 \(mm, CAD\)"),
        ((0, 0, 40, 30), 200.0, r"40.0 × 30.0 mm, 48 megapixels at 200 px/mm, but the limit is 16.* 115.4 px/mm"),
    ],
)
def test_regions_off_the_board_or_too_large_are_refused(corners: Any, px_per_mm: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        region_component(corners, board(), px_per_mm)


def test_views_lie_in_the_plane_of_the_top(small_views: tuple[ViewCalculator, Component]) -> None:
    calculator, part = small_views
    low, high = (views_on_top(calculator, part, h, min_coverage=0.5) for h in (0.0, 2.0))
    assert {v.plane for v in low} == {"board"}
    assert {(v.plane, v.height_mm) for v in high} == {("top", 2.0)}
    assert len(views_on_top(calculator, part, 0.0)) >= len(low)
    shifts = [np.abs(a.matrix - b.matrix).max() for a, b in zip(low, high, strict=False)]
    assert max(shifts) > 0.5
