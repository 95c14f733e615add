"""Nominal views of cameras of which station.toml states none."""

from __future__ import annotations

import pytest

from vaoi_station.api.setup.design import nominal_heads
from vaoi_station.errors import InputError
from vaoi_station.model import CameraHead

BARE = CameraHead(width=640, height=480, exposure_us=250.0)
STATED = BARE.model_copy(update={"nominal_center_mm": (7.0, 1.0), "nominal_px_per_mm": 18.0})


def test_missing_views_are_those_of_an_evenly_spaced_array() -> None:
    made = nominal_heads([BARE, BARE, BARE], pitch_mm=33.0, px_per_mm=40.0)
    assert [head.nominal_center_mm for head in made] == [(0.0, 0.0), (33.0, 0.0), (66.0, 0.0)]
    assert [head.nominal_px_per_mm for head in made] == [40.0] * 3


def test_what_station_toml_states_holds() -> None:
    assert nominal_heads([STATED, STATED]) == (STATED, STATED)
    assert nominal_heads([STATED], pitch_mm=33.0, px_per_mm=40.0) == (STATED,)


def test_a_single_camera_needs_no_distance() -> None:
    assert nominal_heads([BARE], px_per_mm=40.0)[0].nominal_center_mm == (0.0, 0.0)


def test_what_is_missing_is_named() -> None:
    for heads, given, message in (
        ([BARE, BARE], {}, "pitch_mm and px_per_mm must be given"),
        ([BARE, BARE], {"pitch_mm": 33.0}, "^px_per_mm must be given"),
        ([STATED, BARE], {"px_per_mm": 40.0}, "^pitch_mm must be given"),
    ):
        with pytest.raises(InputError, match=message) as refused:
            nominal_heads(heads, **given)
        assert refused.value.code == "nominal-values-missing"
