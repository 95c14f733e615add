"""Covered marks and blurred frames of the twin: accepted calibrations and messages of refusals."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest

from vaoi_station.calibration import Outcome, calibrate
from vaoi_station.calibration.pictures.calibration_picture import draw_calibration
from vaoi_station.files.calibrations import Layout
from vaoi_station.simulation import Twin, calibration_board
from vaoi_station.simulation.scenario import ArraySection, CalibrationBoardSection, Scenario

Change = Callable[[Any], Any]
SPOILT = 1
"""The camera whose frame is changed."""
GREYS = (205, 120, 25)
"""Of what covers: as the board, as a finger, as the marks."""


class Film:
    """The calibration board of the paper's three cameras."""

    def __init__(self, marks_per_axis: int) -> None:
        board = CalibrationBoardSection(marks_per_axis=marks_per_axis)
        self.twin = Twin(Scenario(array=ArraySection(), calibration_board=board))
        self.layout = Layout.model_validate(calibration_board.layout(self.twin))
        self.frames = {camera: frame for camera, _, frame in calibration_board.frames(self.twin)}
        self.first = marks_per_axis**2
        """Mark of the layout at the top left of the spoilt camera's view."""

    def calibrate(self, change: Change) -> Outcome:
        def frame(camera: int) -> Any:
            return change(self.frames[camera].copy()) if camera == SPOILT else self.frames[camera]

        return calibrate(self.twin.heads, frame, self.layout)

    def seen_at(self, mark: int) -> Any:
        return self.twin.pinholes[SPOILT].project(calibration_board.mark_places_mm(self.twin)[mark][None], 0.0)[0]

    def covered(self, mark: int, share: float, grey: int) -> Outcome:
        """With something over the left part of a mark; its arms end 40 px from its middle."""
        x, y = self.seen_at(mark)

        def cover(frame: Any) -> Any:
            frame[round(y - 48) : round(y + 48), round(x - 48) : round(x - 40 + 80 * share)] = grey
            return frame

        return self.calibrate(cover)

    def worst_px(self, outcome: Outcome) -> float:
        """The largest rms over a frame of where raw pixels lie by the calibration and in truth."""
        worst = 0.0
        for camera, pinhole in zip(outcome.calibration().cameras(self.twin.heads), self.twin.pinholes, strict=True):
            x, y = np.linspace(0, camera.width_px - 1, 9), np.linspace(0, camera.height_px - 1, 9)
            grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
            off = pinhole.project(camera.ground(grid), 0.0) - grid
            worst = max(worst, float(np.sqrt((off**2).sum(1).mean())))
        return worst


@pytest.fixture(scope="module", params=[2, 3], ids=["4 marks", "9 marks"])
def film(request: pytest.FixtureRequest) -> Film:
    return Film(request.param)


@pytest.fixture(scope="module")
def four() -> Film:
    return Film(2)


@pytest.fixture(scope="module")
def nine() -> Film:
    return Film(3)


@pytest.mark.parametrize("grey", GREYS)
@pytest.mark.parametrize("share", [1.0, 0.5, 0.2])
def test_of_four_marks_one_covered_is_refused_with_its_place(four: Film, share: float, grey: int) -> None:
    outcome = four.covered(four.first, share, grey)
    assert [bool(c.refusal) for c in outcome.cameras] == [False, True, False]
    x, y = four.seen_at(four.first)
    said = re.fullmatch(
        r"camera 1: it shows 3 marks, of which 3 fit the layout; at least 4 are needed; "
        r"no whole mark is seen at \((\d+), (\d+)\) px, where the layout has one\.",
        outcome.error().message,
    )
    assert said is not None, outcome.error().message
    assert np.hypot(int(said[1]) - x, int(said[2]) - y) < 5
    assert "uncover them" in outcome.error().action


def test_the_picture_of_a_covered_mark_shows_in_red_which_it_is(four: Film) -> None:
    picture = draw_calibration(four.covered(four.first, 0.5, 120))
    width = (picture.shape[1] - 16) // 3
    frame = picture[74:, width + 8 : 2 * width + 8].astype(int)
    scale = width / four.twin.heads[SPOILT].width
    red, green, yellow = (40, 40, 230), (60, 200, 60), (0, 200, 230)
    for mark in range(four.first, four.first + 4):
        x, y = np.round(four.seen_at(mark) * scale).astype(int)
        around = frame[y - 14 : y + 15, x - 14 : x + 15].reshape(-1, 3)
        shown = [bool((np.abs(around - colour).max(-1) < 30).any()) for colour in (red, green, yellow)]
        assert shown == ([True, False, False] if mark == four.first else [False, True, False]), mark


@pytest.mark.parametrize("grey", GREYS)
@pytest.mark.parametrize("share", [1.0, 0.5, 0.2])
def test_of_nine_marks_one_covered_is_reported_and_has_no_effect(nine: Film, share: float, grey: int) -> None:
    outcome = nine.covered(nine.first, share, grey)
    assert [c.used for c in outcome.cameras] == [9, 8, 9]
    x, y = nine.seen_at(nine.first)
    assert re.match(rf"camera 1: the mark expected at \({x:.0f}, {y:.0f}\) px .*; not used$", outcome.notes[0])
    assert nine.worst_px(outcome) < 0.02


@pytest.mark.parametrize("sigma_px", [3.0, 8.0])
def test_a_camera_out_of_focus_is_refused_with_its_blur(film: Film, sigma_px: float) -> None:
    outcome = film.calibrate(lambda frame: cv2.GaussianBlur(frame, (0, 0), sigma_px))
    assert [bool(c.refusal) for c in outcome.cameras] == [False, True, False]
    error = outcome.error()
    said = re.fullmatch(
        r"camera 1: its picture is blurred by (\d+\.\d) px \(sigma\), the limit is 2\.0 px\.", error.message
    )
    assert said is not None, error.message
    assert float(said[1]) == pytest.approx(sigma_px, rel=0.1)
    assert error.action.startswith("Focus the lens")
