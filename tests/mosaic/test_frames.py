"""The choice of frames by light and exposure."""

from __future__ import annotations

import pytest

from vaoi_station.errors import InputError
from vaoi_station.model import RecordingHead
from vaoi_station.mosaic.frames import TakenFrame, choose_frames, frames_of_head

LIT = tuple(TakenFrame(0, j, 250.0, 1.0, ("even", "left", "even")[j % 3]) for j in range(6))
BRACKETED = tuple(TakenFrame(i, j, (250.0, 15.0)[j % 2]) for j in range(4) for i in range(2))


def test_light_of_most_rows_is_taken_unless_one_is_named() -> None:
    assert choose_frames(LIT).light == "even"
    assert [f.row for f in choose_frames(LIT, light="left").frames] == [1, 4]


def test_unknown_light_is_refused_with_the_lights_there_are() -> None:
    with pytest.raises(InputError, match="light is 'top', but must be one of the 2 lights of the run: 'even', 'left'"):
        choose_frames(LIT, light="top")
    with pytest.raises(InputError, match="none that is named"):
        choose_frames(BRACKETED, light="even")


def test_hdr_has_one_layer_per_exposure_and_similar_ones_share_a_layer() -> None:
    choice = choose_frames((*BRACKETED, TakenFrame(0, 9, 240.0)), hdr=True)
    assert [sorted({f.exposure_us for f in layer}) for layer in choice.layers] == [[240.0, 250.0], [15.0]]


def test_frames_of_a_head_are_those_that_arrived_with_what_they_were_taken_with() -> None:
    head = RecordingHead.model_validate(
        {
            "format": "vaoi-recording",
            "version": 1,
            "cameras": [{"width": 16, "height": 16, "exposure_us": 250.0}] * 2,
            "rows": 2,
            "trigger_period_s": 0.1,
            "conveyor_mm_s": [0, 100],
            "missing": [[1, 0]],
            "lights": ["even", "left"],
            "exposures_us": [[250, 15], [250, 15]],
        }
    )
    assert frames_of_head(head) == (
        TakenFrame(0, 0, 250, 1, "even"),
        TakenFrame(0, 1, 250, 1, "left"),
        TakenFrame(1, 1, 15, 1, "left"),
    )
