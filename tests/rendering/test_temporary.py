"""Temporary images, rendered from frames that are exact pictures of known patterns."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from tests.rendering.computed import compute_views
from vaoi_station.rendering import ViewCalculator, render, render_all

BENT = (0.012, 0.001)


def pixels_of(shape: tuple[int, ...]) -> Any:
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    return np.stack([x, y], -1)


def frame_of(s: Any, camera: int, row: int, dots: list[tuple[float, float]], radius_mm: float = 0.25) -> Any:
    """Render soft dots at CAD places, pixel by pixel through the inverse of the model."""
    places = s.raw_px(camera, row, np.array(dots))
    at = pixels_of((s.cameras[camera].height_px, s.cameras[camera].width_px))
    reach = radius_mm * s.cameras[camera].px_per_mm
    picture = sum(np.exp(-((at - p) ** 2).sum(-1) / (2 * reach**2)) for p in places)
    return np.clip(np.round(20 + 200 * np.asarray(picture)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("lens", [(), BENT])
@pytest.mark.parametrize(("y_axis", "side"), [(y, s) for y in ("up", "down") for s in ("top", "bottom")])
def test_a_dot_lies_where_cad_says(make: Any, y_axis: str, side: str, lens: Any) -> None:
    s = make(y_axis=y_axis, side=side, lens=lens)
    component = s.board_type.components[4]
    dot = (component.center[0] + 1.3, component.center[1] + 0.6)
    for view in compute_views(component, s.board_type, s.stitch, s.cameras, px_per_mm=16.0, min_coverage=0.99):
        picture = render(view, frame_of(s, view.camera, view.row, [dot])).astype(float) - 20
        assert picture.shape == (view.height, view.width)
        weight = np.maximum(picture, 0)[..., None]
        found = (pixels_of(picture.shape) * weight).sum((0, 1)) / weight.sum()
        assert found == pytest.approx(view.crop_from_cad(np.array(dot)), abs=0.1)
        right, up = found[0] > (view.width - 1) / 2, found[1] < (view.height - 1) / 2
        assert right == (side == "top")
        assert up == (y_axis == "up")


def test_a_linear_ramp_is_reproduced_exactly(make: Any) -> None:
    """Bilinear interpolation reproduces linear brightness exactly: no half pixel is lost."""
    s = make()
    at = pixels_of((180, 240))
    frame = (20 + 0.6 * at[..., 0] + 0.4 * at[..., 1]).astype(np.float32)
    for view in compute_views(s.board_type.components[4], s.board_type, s.stitch, s.cameras, min_coverage=1.0):
        where = view.image_from_crop(pixels_of((view.height, view.width)))
        assert np.abs(render(view, frame) - (20 + where @ (0.6, 0.4))).max() < 0.01


def test_tiles_match_a_remap_of_every_pixel(make: Any) -> None:
    big = [{"ref": "ALL", "center": [20, 15], "width": 26, "height": 20}]
    s = make(lens=(0.0016,), components=big)  # a quarter of a pixel at the corner of so small a frame
    at, shown = pixels_of((180, 240)), 0
    texture = 128 + 60 * np.cos(at[..., 0] / 6) * np.cos(at[..., 1] / 7) + 40 * np.cos((at[..., 0] + at[..., 1]) / 5)
    frame = np.clip(np.round(texture), 0, 255).astype(np.uint8)
    views = compute_views(
        s.board_type.components[0], s.board_type, s.stitch, s.cameras, px_per_mm=24.0, min_coverage=0.2
    )
    for view in [v for v in views if v.distorted]:
        grid = pixels_of((view.height, view.width))
        raw = s.raw_px(view.camera, view.row, view.cad_from_crop(grid)).astype(np.float32)
        exact = cv2.remap(frame, raw[..., 0], raw[..., 1], cv2.INTER_LINEAR)
        inside = s.cameras[view.camera].sees(raw, 1.0)
        off = np.abs(render(view, frame).astype(int) - exact.astype(int))[inside]
        assert off.max() <= 1
        shown += 1
    assert shown >= 2


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [(), (3,)])
@pytest.mark.parametrize("lens", [(), BENT])
def test_pictures_of_many_views_are_those_of_each(make: Any, lens: Any, channels: Any, dtype: Any) -> None:
    s = make(lens=lens)
    table = ViewCalculator(s.board_type, s.stitch, s.cameras).compute_all(s.board_type.components, min_coverage=0.3)
    views = [view for of_part in table.values() for view in of_part]
    random, most = np.random.default_rng(5), np.iinfo(dtype).max
    keys = sorted({(view.camera, view.row) for view in views})[1:]
    frames = {key: random.integers(0, most, (180, 240, *channels)).astype(dtype) for key in keys}
    pictures = render_all(table, lambda i, j: frames.get((i, j)))
    assert len(pictures) == len(views)
    missing = [n for n, view in enumerate(views) if (view.camera, view.row) not in frames]
    assert missing
    for n, (view, picture) in enumerate(zip(views, pictures, strict=True)):
        if n in missing:
            assert picture is None
        else:
            assert picture is not None
            assert picture.dtype == dtype
            assert np.array_equal(picture, render(view, frames[view.camera, view.row]))


def by_equation_22(s: Any, view: Any, frame: Any) -> Any:
    """Every pixel by itself: to CAD, through C, D_j, N_i and the lens, then interpolate in double precision."""
    at = s.raw_px(view.camera, view.row, view.cad_from_crop(pixels_of((view.height, view.width))))
    inside = s.cameras[view.camera].sees(at)
    low = np.clip(np.floor(at), 0, np.array(frame.shape[1::-1]) - 2).astype(int)
    share = at - low
    (x, y), values = low.transpose(2, 0, 1), frame.astype(np.float64)
    u, v = (share[..., k].reshape(*share.shape[:2], *[1] * (frame.ndim - 2)) for k in (0, 1))
    top = (1 - u) * values[y, x] + u * values[y, x + 1]
    bottom = (1 - u) * values[y + 1, x] + u * values[y + 1, x + 1]
    return (1 - v) * top + v * bottom, inside


@pytest.mark.parametrize(("lens", "bends"), [((), False), ((0.0016,), True)])
@pytest.mark.parametrize("channels", [(), (3,)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_what_is_delivered_is_equation_22_within_one_grey_level(
    make: Any, dtype: Any, channels: Any, lens: Any, bends: bool
) -> None:
    big = [{"ref": "ALL", "center": [20, 15], "width": 24, "height": 16}]
    s = make(lens=lens, components=big)
    random, most = np.random.default_rng(5), np.iinfo(dtype).max
    noise = cv2.GaussianBlur(random.normal(size=(180, 240, *channels)), (0, 0), 1.2)
    frame = np.clip(most * (0.5 + 0.25 * noise / noise.std()), 0, most).astype(dtype)
    views = compute_views(
        s.board_type.components[0], s.board_type, s.stitch, s.cameras, px_per_mm=16.0, min_coverage=0.3
    )
    assert any(v.distorted for v in views) == bends
    for view in views[:3]:
        expected, inside = by_equation_22(s, view, frame)
        off = np.abs(render(view, frame) - expected)[inside]
        # The lens is right to 0.004 px, which the steepest edge of this texture turns into levels of 16 bit.
        slope = np.abs(np.diff(frame.astype(float), axis=1)).max() if bends else 0.0
        assert off.max() <= max(1.0, 0.004 * slope if dtype == np.uint16 else 0.0)
