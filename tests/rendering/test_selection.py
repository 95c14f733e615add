"""Selections of images by light, direction, exposure and quality."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import cv2
import numpy as np
import pytest

from tests.rendering.computed import compute_views
from vaoi_station.api.rest_models import ViewEntry
from vaoi_station.errors import InputError, StateError
from vaoi_station.photometry import WhiteBalance
from vaoi_station.rendering import (
    ChosenImages,
    View,
    ViewCalculator,
    choose_all,
    render,
    render_chosen,
)
from vaoi_station.rendering.request import ImageOptions, ImageRequest
from vaoi_station.rendering.selection import ChosenView, FrameFacts, Measures, describe, measure, select

LIGHTS = ("even", "left", "right", "left")


@pytest.fixture(scope="module")
def views(make: Any) -> tuple[View, ...]:
    """All views of a large component: 2 cameras and 4 rows, each row with its light."""
    s = make(components=[{"ref": "U1", "center": [20, 15], "width": 9, "height": 6}])
    found = compute_views(s.board_type.components[0], s.board_type, s.stitch, s.cameras, min_coverage=0.2)
    assert len({v.row for v in found}) >= 3
    return found


def facts() -> dict[tuple[int, int], FrameFacts]:
    return {(i, j): FrameFacts(100.0 * (j + 1), 1.0 + i, LIGHTS[j], 0.1 * j) for i in range(2) for j in range(4)}


def chosen(
    views: tuple[View, ...], by: Callable[[View], Measures | None] | None = None, **options: Any
) -> list[ChosenView]:
    def unexpected(_: View) -> Measures | None:
        raise AssertionError("measured without need")

    return list(select(views, facts(), ImageRequest.of(cast("ImageOptions", options)), by or unexpected))


def test_an_unknown_light_is_refused_with_the_known_ones(views: tuple[View, ...]) -> None:
    with pytest.raises(
        InputError, match="light is 'blue', but must be one of the lights of this run: even, left, right"
    ):
        chosen(views, light="blue")
    with pytest.raises(InputError, match="minus is 'blue'"):
        chosen(views, light="left", minus="blue")
    with pytest.raises(InputError, match="none, because its rows have no named lights"):
        select(views, {}, ImageRequest.of({"light": "left"}), lambda _: None)


@pytest.mark.parametrize(("side", "azimuth"), [("right", 0), ("back", 90), ("left", 180), ("front", 270)])
def test_one_side_of_the_picture(views: tuple[View, ...], side: str, azimuth: float) -> None:
    def apart(view: View) -> float:
        seen = view.picture_azimuth_deg
        assert seen is not None
        return abs((seen - azimuth + 180) % 360 - 180)

    assert [s.view for s in chosen(views, seen_from=side)] == [v for v in views if apart(v) <= 45]
    assert [s.view for s in chosen(views, seen_from=side, within_deg=100)] == [v for v in views if apart(v) <= 100]


def test_one_azimuth_in_cad_and_angles_from_the_vertical(views: tuple[View, ...]) -> None:
    first = views[0]
    assert first.azimuth_deg is not None
    found = chosen(views, seen_from=first.azimuth_deg, within_deg=1.0)
    assert first in [s.view for s in found]
    angles = sorted(v.angle_deg or 0.0 for v in views)
    middle = (angles[0] + angles[-1]) / 2
    assert {s.view for s in chosen(views, max_angle_deg=middle)} == {v for v in views if (v.angle_deg or 0) <= middle}
    assert {s.view for s in chosen(views, min_angle_deg=middle)} == {v for v in views if (v.angle_deg or 0) >= middle}


def test_without_directions_a_direction_is_refused(make: Any) -> None:
    s = make()
    blind = tuple(replace(c, working_distance_mm=None) for c in s.cameras)
    views = compute_views(s.board_type.components[0], s.board_type, s.stitch, blind)
    with pytest.raises(StateError, match="states no working distance") as refused:
        chosen(views, seen_from="left")
    assert refused.value.code == "no-working-distance"


def test_sharpest_first_puts_saturated_and_partial_images_last(views: tuple[View, ...]) -> None:
    whole = [v for v in views if v.coverage == 1.0][:3]
    partial = next(v for v in views if v.coverage < 0.9)
    figures = dict(zip(whole, [Measures(5.0, 0.0), Measures(7.0, 0.002), Measures(9.0, 0.2)], strict=False)) | {
        partial: Measures(20.0, 0.0)
    }
    found = chosen((*whole, partial), figures.get, order="sharpest")
    expected = [whole[1], whole[0], *whole[2:], partial]
    assert [s.view for s in found] == expected
    kept = chosen((*whole, partial), figures.get, min_sharpness_per_mm=6.0, max_saturated=0.1)
    assert [s.view for s in kept] == [whole[1], partial]


def test_a_difference_takes_the_other_light_from_the_nearest_direction(views: tuple[View, ...]) -> None:
    found = chosen(views, light="left", minus="right")
    assert found
    for choice in found:
        assert choice.minus is not None
        assert choice.minus.facts.light == "right"
        assert choice.minus.view.camera == choice.view.camera, "the same camera sees it most nearly from the same side"
        expected = 100.0 * (choice.view.row + 1) / 300.0
        assert choice.ratio == pytest.approx(expected)
    assert chosen(tuple(v for v in views if v.row != 2), light="left", minus="right") == []


FACTS = {
    (i, j): FrameFacts(100.0 + 100 * j, 1.0, "left" if j % 2 else "right", 0.1 * j) for i in range(2) for j in range(4)
}


def chosen_of(s: Any, quality: dict[str, Any] | None = None, **options: Any) -> ChosenImages:
    stitch = s.stitch.model_copy(update={"quality": quality or {}})
    calculator = ViewCalculator(s.board_type, stitch, s.cameras)
    wanted = ImageRequest.of(cast("ImageOptions", options))
    frames = set(FACTS) - {(0, 0)}, FACTS
    part = s.board_type.components[4]
    return choose_all(calculator, [part], (s.board_type, stitch), frames, wanted, lambda _: None)[0]


def test_only_usable_frames_are_taken(make: Any) -> None:
    found = chosen_of(make(), min_coverage=0.2)
    assert found.chosen
    assert (0, 0) not in {(s.view.camera, s.view.row) for s in found.chosen}
    assert (found.height, found.remark) == (None, None)


def test_the_top_plane_is_at_the_measured_height_and_its_error_counts(make: Any) -> None:
    s = make()
    found = chosen_of(s, {"heights_mm": {"U4": 1.5}, "height_sigma_mm": {"U4": 0.3}}, plane="top")
    assert {(x.view.plane, x.view.height_mm) for x in found.chosen} == {("top", 1.5)}
    assert found.remark is None
    choice, flat = found.chosen[0], [[0.0001, 0.0], [0.0, 0.0001]]
    covariance = found.covariance_px2(choice, flat)
    assert covariance is not None
    extra = np.trace(covariance) - 0.0002
    assert extra == pytest.approx(0.09 * (choice.view.lift_px**2).sum())
    assert found.covariance_px2(choice, None) is None


def test_a_difference_is_rendered_with_equal_exposures(make: Any) -> None:
    s = make()
    choice = next(x for x in chosen_of(s, light="left", minus="right").chosen if x.view.coverage == 1)
    assert choice.minus is not None
    scene = np.full((180, 240), 30.0)
    frame, other = (np.asarray(scene * x.facts.exposure_us / 100, np.uint8) for x in (choice, choice.minus))
    assert (render_chosen(choice, frame, other) == 128).all()
    assert (render_chosen(choice, frame) == render(choice.view, frame)).all()


def test_white_is_grey_in_the_difference_of_two_lights_of_different_tint(make: Any) -> None:
    choice = next(x for x in chosen_of(make(), light="left", minus="right").chosen if x.view.coverage == 1)
    assert choice.minus is not None
    warm = choice.facts._replace(white_balance=WhiteBalance((1.0, 1.25, 2.5)))
    cold = choice.minus.facts._replace(white_balance=WhiteBalance((2.0, 1.0, 1.0)))
    balanced = replace(choice, facts=warm, minus=replace(choice.minus, facts=cold))
    scenes = ((40, 80, 100), (100, 100, 50))  # blue, green, red
    frames = [
        np.asarray(np.full((180, 240, 3), scene) * x.facts.exposure_us / 400, np.uint8)
        for scene, x in zip(scenes, (choice, choice.minus), strict=True)
    ]
    assert np.abs(render_chosen(balanced, *frames).astype(int) - 128).max() <= 2
    assert np.ptp(render_chosen(choice, *frames)[9, 9]) > 10
    assert describe(balanced, None)["white_balance"] == (1.0, 1.25, 2.5)


@pytest.fixture(scope="module")
def view(make: Any) -> View:
    s = make()
    return compute_views(s.board_type.components[4], s.board_type, s.stitch, s.cameras, min_coverage=1.0)[0]


def scene(blur_px: float = 0.0, shape: tuple[int, ...] = (180, 240)) -> Any:
    random = np.random.default_rng(2)
    blocks = cv2.resize(random.uniform(40, 200, (60, 80)), shape[1::-1], interpolation=cv2.INTER_NEAREST)
    return cv2.GaussianBlur(blocks, (0, 0), blur_px) if blur_px else blocks


def with_noise(values: Any, sigma: float) -> Any:
    noise = np.random.default_rng(7).normal(0, sigma, values.shape) if sigma else 0.0
    return np.clip(np.rint(values + noise), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_sharpness_falls_with_every_blur(view: View, noise: float) -> None:
    found = [
        measure(view, with_noise(scene(blur), noise)).sharpness_per_mm or 0.0 for blur in (0.5, 0.8, 1.2, 1.8, 2.5)
    ]
    assert found == sorted(found, reverse=True)
    assert found[0] > 1.5 * found[-1] > 0


def test_sharpness_does_not_depend_on_exposure_noise_or_depth(view: View) -> None:
    bright = measure(view, with_noise(scene(1.0), 0.0)).sharpness_per_mm
    assert bright is not None
    assert measure(view, with_noise(scene(1.0) / 3, 0.0)).sharpness_per_mm == pytest.approx(bright, rel=0.02)
    assert measure(view, with_noise(scene(1.0) / 3, 2.0)).sharpness_per_mm == pytest.approx(bright, rel=0.1)
    deep = measure(view, with_noise(scene(1.0), 0.0).astype(np.uint16) * 257)
    assert deep.sharpness_per_mm == pytest.approx(bright, rel=1e-3)
    colour = measure(view, cv2.merge([with_noise(scene(1.0), 0.0)] * 3))
    assert colour.sharpness_per_mm == pytest.approx(bright, rel=0.02)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_saturated_pixels_of_the_footprint_are_counted(view: View, dtype: Any) -> None:
    frame = scene(1.0).astype(dtype)
    left, top = np.ceil(view.outline_px.min(0)).astype(int) + 2
    frame[top : top + 6, left : left + 5] = np.iinfo(dtype).max
    frame[:10, :10] = np.iinfo(dtype).max  # outside the footprint
    area = 40 * 24 * (view.frame_px_per_mm / 8.0) ** 2
    assert measure(view, frame).saturated == pytest.approx(30 / area, rel=0.08)


def test_names_are_those_of_the_rest_interface_and_of_the_library(make: Any) -> None:
    s = make()
    view = compute_views(s.board_type.components[0], s.board_type, s.stitch, s.cameras)[0]
    known = describe(ChosenView(view, FrameFacts()), None)
    assert set(known) == set(ViewEntry.model_fields) - {"k", "url"}
