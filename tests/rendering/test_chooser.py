"""The images of a component as a request describes them: plane, uncertainty, rendering."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from vaoi_station.rendering import (
    ChosenImages,
    ImageOptions,
    ImageRequest,
    ViewCalculator,
    choose_images,
    render,
    render_chosen,
)
from vaoi_station.rendering.description import describe
from vaoi_station.rendering.selection import FrameFacts

FACTS = {
    (i, j): FrameFacts(100.0 + 100 * j, 1.0, "left" if j % 2 else "right", 0.1 * j) for i in range(2) for j in range(4)
}


def chosen(s: Any, quality: dict[str, Any] | None = None, **options: Any) -> ChosenImages:
    stitch = s.stitch.model_copy(update={"quality": quality or {}})
    calculator = ViewCalculator(s.board_type, stitch, s.cameras)
    wanted = ImageRequest.of(cast("ImageOptions", options))
    frames = set(FACTS) - {(0, 0)}, FACTS
    return choose_images(calculator, s.board_type.components[4], (s.board_type, stitch), frames, wanted, lambda _: None)


def test_only_usable_frames_are_taken(make: Any) -> None:
    found = chosen(make(), min_coverage=0.2)
    assert found.chosen
    assert (0, 0) not in {(s.view.camera, s.view.row) for s in found.chosen}
    assert (found.height, found.remark) == (None, None)


def test_the_top_plane_is_at_the_measured_height_and_its_error_counts(make: Any) -> None:
    s = make()
    found = chosen(s, {"heights_mm": {"U4": 1.5}, "height_sigma_mm": {"U4": 0.3}}, plane="top")
    assert {(x.view.plane, x.view.height_mm) for x in found.chosen} == {("top", 1.5)}
    assert found.remark is None
    choice, flat = found.chosen[0], [[0.0001, 0.0], [0.0, 0.0001]]
    covariance = found.covariance_px2(choice, flat)
    assert covariance is not None
    extra = np.trace(covariance) - 0.0002
    assert extra == pytest.approx(0.09 * (choice.view.lift_px**2).sum())
    assert found.covariance_px2(choice, None) is None


def test_a_part_without_a_height_is_answered_in_the_plane_of_the_board(make: Any) -> None:
    found = chosen(make(), plane="top")
    assert {(x.view.plane, x.view.height_mm) for x in found.chosen} == {("board", 0.0)}
    assert "U4 has no height: the run measured none" in (found.remark or "")


def test_without_a_working_distance_images_lie_on_the_board(make: Any) -> None:
    s = make()
    cameras = tuple(replace(camera, working_distance_mm=None) for camera in s.cameras)
    found = chosen(SimpleNamespace(**{**vars(s), "cameras": cameras}), {"heights_mm": {"U4": 1.5}}, plane="top")
    assert {x.view.plane for x in found.chosen} == {"board"}
    assert "no working_distance_mm" in (found.remark or "")


def test_a_difference_is_rendered_with_equal_exposures(make: Any) -> None:
    s = make()
    choice = next(x for x in chosen(s, light="left", minus="right").chosen if x.view.coverage == 1)
    assert choice.minus is not None
    scene = np.full((180, 240), 30.0)
    frame, other = (np.asarray(scene * x.facts.exposure_us / 100, np.uint8) for x in (choice, choice.minus))
    assert (render_chosen(choice, frame, other) == 128).all()
    assert (render_chosen(choice, frame) == render(choice.view, frame)).all()


def test_a_description_has_what_is_known(make: Any) -> None:
    choice = chosen(make(), light="left", minus="right").chosen[0]
    known = describe(choice, np.diag([0.0004, 0.0001]))
    assert known["sigma_px"] == pytest.approx(0.02)
    assert known["sigma_mm"] == pytest.approx(0.02 / choice.view.frame_px_per_mm)
    assert (known["light"], known["exposure_us"], known["time_s"]) == choice.facts[2:3] + choice.facts[
        0:1
    ] + choice.facts[3:4]
    assert known["minus"] == (choice.minus.view.camera, choice.minus.view.row) if choice.minus else None
    assert (known["sharpness_per_mm"], known["saturated"]) == (None, None)
    assert describe(choice, None)["sigma_mm"] is None
