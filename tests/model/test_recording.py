from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from vaoi_station.model import ProgramStep, RecordingHead


def head(**change: Any) -> RecordingHead:
    base = {
        "format": "vaoi-recording",
        "version": 1,
        "cameras": [{"width": 80, "height": 64, "exposure_us": e} for e in (200.0, 250.0)],
        "rows": 3,
        "trigger_period_s": 0.125,
        "conveyor_mm_s": [0, -100],
    }
    return RecordingHead.model_validate(base | change)


def test_the_way_of_the_belt_replaces_the_times_in_the_prior_of_the_motion() -> None:
    given = head(trigger_times_s=[5.0, 5.2, 5.3], belt_mm=[0.0, 8.0, 16.0], conveyor_mm_s=[0.0, -80.0])
    assert given.row_times_s().tolist() == [5.0, 5.2, 5.3]
    assert given.motion_times_s().tolist() == [0.0, 0.1, 0.2]
    assert head(trigger_times_s=[5.0, 5.2, 5.3]).motion_times_s().tolist() == [5.0, 5.2, 5.3]


def test_exposures_are_those_of_the_camera_unless_given_per_frame() -> None:
    assert [head().exposure_us(camera, 2) for camera in (0, 1)] == [200.0, 250.0]
    hdr = head(exposures_us=[[10.0, 20], [30, 40], [50, 60]])
    assert hdr.exposure_us(1, 0) == 20
    assert hdr.exposure_us(0, 2) == 50


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"missing": [(2, 0)]}, r"missing names \[2, 0\], but there are 2 cameras and 3 rows"),
        ({"missing": [(0, 3)]}, r"missing names \[0, 3\]"),
        ({"missing": [(-1, 0)]}, r"missing names \[-1, 0\]"),
        ({"trigger_times_s": [0, 1]}, "trigger_times_s has 2 entries, must have one per row: 3"),
        ({"trigger_times_s": [0, 2, 2]}, "must increase from row to row"),
        ({"belt_mm": [0.0, 1.0]}, "belt_mm has 2 entries"),
        ({"belt_mm": [0.0, 2.0, 2.0]}, "belt_mm must increase"),
        ({"exposures_us": [[1.0, 2.0]]}, "exposures_us has 1 entries"),
        ({"exposures_us": [[1.0, 2.0], [1.0], [1.0, 2.0]]}, "exposures_us must have 2 entries in every row"),
        ({"gains": [[1.0, 2.0]]}, "gains has 1 entries"),
        ({"gains": [[1.0, 2.0], [1.0], [1.0, 2.0]]}, "gains must have 2 entries in every row"),
        ({"gains": [[1.0, 0.0]] * 3}, "gains"),
        ({"lights": ["a"]}, "lights has 1 entries"),
        ({"rows": 0}, "rows"),
        ({"cameras": []}, "cameras"),
    ],
)
def test_inconsistent_heads_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        head(**change)


@pytest.mark.parametrize(
    "wrong",
    [{"on_us": 0}, {"exposure_us": "200"}, {"exposure_us": []}, {"gain_db": [90.0]}, {"light": ""}, {"lamp": 1}],
)
def test_impossible_values_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        ProgramStep.model_validate({"light": "left", **wrong})
