"""Selections of images by light, direction, exposure and quality."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import pytest

from vaoi_station.errors import InputError, StateError
from vaoi_station.rendering import View, compute_views
from vaoi_station.rendering.measures import Measures
from vaoi_station.rendering.request import ImageOptions, ImageRequest
from vaoi_station.rendering.selection import ChosenView, FrameFacts, select

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


def test_without_a_wish_all_views_come_in_their_order(views: tuple[View, ...]) -> None:
    assert [s.view for s in chosen(views)] == list(views)
    assert all(s.facts == facts()[s.view.camera, s.view.row] for s in chosen(views))


def test_one_light(views: tuple[View, ...]) -> None:
    found = chosen(views, light="left")
    assert [s.view for s in found] == [v for v in views if v.row in (1, 3)]
    assert len(chosen(views, light="left", limit=1)) == 1


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


def test_exposures(views: tuple[View, ...]) -> None:
    assert {s.view.row for s in chosen(views, max_exposure_us=200)} <= {0, 1}
    assert {s.view.row for s in chosen(views, min_exposure_us=150, max_exposure_us=350)} <= {1, 2}
    unknown = select(views, {}, ImageRequest.of({"min_exposure_us": 1.0}), lambda _: None)
    assert unknown == ()


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


def test_measures_are_given_on_request(views: tuple[View, ...]) -> None:
    found = chosen(views, lambda _: Measures(3.0, 0.1), measure=True, limit=2)
    assert [s.measures for s in found] == [Measures(3.0, 0.1)] * 2
    gone = chosen(views, lambda _: None, measure=True)
    assert {s.measures for s in gone} == {None}


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
