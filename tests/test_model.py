"""What the nouns compute; what they refuse is tested with the files that hold them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError

from vaoi_station import model
from vaoi_station.geometry import System
from vaoi_station.model import BoardType, Calibration, Component, FrameRecord, FrozenModel, Stitch, Verdict


def board(**change: Any) -> BoardType:
    return BoardType.model_validate({"name": "b"} | change)


def component(**change: Any) -> dict[str, Any]:
    return {"ref": "U1", "center": [10, 20], "width": 4, "height": 2} | change


@pytest.mark.parametrize(
    "noun", [c for c in vars(model).values() if isinstance(c, type) and issubclass(c, FrozenModel)]
)
def test_every_noun_is_frozen(noun: type[BaseModel]) -> None:
    assert noun.model_config.get("frozen") is True


def test_nouns_cannot_be_changed() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        board().name = "other"  # type: ignore[misc]
    n = Calibration(format="vaoi-calibration", version=1, unit="mm", camera_matrices=(np.eye(3),)).camera_matrices[0]
    with pytest.raises(ValueError, match="read-only"):
        n[0, 0] = 2


@pytest.mark.parametrize(
    ("y_axis", "side", "mirrors"),
    [("up", "top", True), ("down", "top", False), ("up", "bottom", False), ("down", "bottom", True)],
)
def test_handedness_follows_from_axis_and_side_alone(y_axis: str, side: str, mirrors: bool) -> None:
    assert board(y_axis=y_axis, side=side).mirrors is mirrors


@pytest.mark.parametrize(("unit", "mm"), [("mm", 1.0), ("inch", 25.4), ("mil", 0.0254)])
def test_units(unit: str, mm: float) -> None:
    assert board(unit=unit).mm_per_unit == pytest.approx(mm)


@pytest.mark.parametrize("y_axis", ["up", "down"])
@pytest.mark.parametrize("side", ["top", "bottom"])
def test_rotation_is_counter_clockwise_as_seen_on_the_top(y_axis: str, side: str) -> None:
    """Seen with CAD x to the right and CAD "up" up, the corner right of the centre goes up."""
    up = 1 if y_axis == "up" else -1
    turned = board(y_axis=y_axis, side=side, components=[component(rotation=30)])
    straight = board(y_axis=y_axis, side=side, components=[component()])
    right = straight.footprint(straight.components[0])[1:3].mean(0) - (10, 20)
    after = turned.footprint(turned.components[0])[1:3].mean(0) - (10, 20)
    np.testing.assert_allclose(right, (2, 0), atol=1e-12)
    np.testing.assert_allclose(after, (2 * math.cos(math.pi / 6), up * 1.0), atol=1e-12)


@given(st.floats(-720, 720), st.floats(0.1, 50), st.floats(0.1, 50))
def test_a_footprint_keeps_centre_and_sides(rotation: float, width: float, height: float) -> None:
    b = board(components=[component(rotation=rotation, width=width, height=height)])
    corners = b.footprint(b.components[0])
    np.testing.assert_allclose(corners.mean(0), (10, 20), atol=1e-9)
    sides = np.hypot(*(np.roll(corners, -1, axis=0) - corners).T)
    np.testing.assert_allclose(sides, (width, height, width, height), rtol=1e-9)


def test_extent_is_of_the_outline_else_of_what_is_placed() -> None:
    parts = [component(rotation=90)]
    low, high = board(outline=[[0, 50], [40, 0]], components=parts).extent()
    assert (low.tolist(), high.tolist()) == ([0, 0], [40, 50])
    low, high = board(components=parts, fiducials=[{"name": "F", "x": 30, "y": 1, "diameter": 1}]).extent()
    np.testing.assert_allclose([low, high], [[9, 1], [30, 22]])
    with pytest.raises(ValueError, match="'b' has neither outline nor fiducials nor components"):
        board().extent()


def test_components_are_found_by_panel_and_ref() -> None:
    b = board(components=[component(), component(panel=2), component(panel="left")])
    assert [c.address for c in b.components] == ["U1", "2/U1", "left/U1"]
    assert b.component("2/U1") is b.components[1]
    assert b.component("3/U1") is None


def test_texts_and_truth_values_are_no_numbers() -> None:
    for bad in ("4", True, float("inf")):
        with pytest.raises(ValidationError, match="width"):
            Component.model_validate(component(width=bad))


def test_own_keys_are_kept_and_others_refused() -> None:
    assert board(x_note="hello").model_extra == {"x_note": "hello"}
    with pytest.raises(ValidationError, match=r"unknown key.*'note'.*'x_'"):
        board(note="hello")


def test_a_stitch_hands_out_transforms_with_their_systems() -> None:
    m = np.diag([40.0, 40, 1])
    stitch = Stitch(
        method="m",
        image_matrices=((m, None),),
        cad_matrix=np.diag([25.4, -25.4, 1]),
        row_motion=(np.eye(3), np.eye(3)),
        status=model.Status.OK,
    )
    image_from_tester, tester_from_cad = stitch.image_from_tester(0, 0), stitch.tester_from_cad
    assert image_from_tester is not None
    assert tester_from_cad is not None
    image_from_cad = image_from_tester @ tester_from_cad
    assert (image_from_cad.target, image_from_cad.source) == (System.IMAGE, System.CAD)
    np.testing.assert_allclose(image_from_cad((1, 1)), (1016, -1016))
    assert stitch.image_from_tester(0, 1) is None


def test_records_of_frames_say_what_became_of_them() -> None:
    record = FrameRecord(camera=1, row=2, verdict=Verdict.MISSING, cause="no packet came")
    assert record.slot is None
    assert FrameRecord.model_validate_json(record.model_dump_json()) == record


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"name": "a\nb"}, "name"),
        ({"outline": [[0, 0], [10, 10], [10, 0], [0, 10]]}, "crosses itself: its edges from corners 0 and 2"),
        ({"components": [{"ref": "U\x001", "center": [1, 1], "width": 1, "height": 1}]}, "ref"),
    ],
)
def test_names_nobody_can_address_and_outlines_nobody_can_cut(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        BoardType.model_validate({"name": "board", "outline": [[0, 0], [10, 10]], **change})
