"""The coarse search finds the deviation from the nominal motion, or refuses with a reason."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from vaoi_station.geometry.robust import Failure
from vaoi_station.stitching.matching.frames import PreparedFrame
from vaoi_station.stitching.matching.link import CoarseShift, best_peaks, correlations, find_shift

SIZE = (640, 480)
REACH = np.array([40.0, 40.0])


def box(shift: tuple[float, float]) -> tuple[int, int, int, int]:
    """The part of frame a that is still in frame b after a shift of the content."""
    x, y = (round(v) for v in shift)
    return max(0, -x), max(0, -y), min(SIZE[0], SIZE[0] - x), min(SIZE[1], SIZE[1] - y)


@pytest.fixture(scope="module")
def frame(workshop: Any) -> PreparedFrame:
    return PreparedFrame(workshop.waves(7, finest=12.0, coarsest=150.0).picture(*SIZE))


@settings(max_examples=8, deadline=None, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(
    nominal=st.tuples(st.integers(-200, 200), st.integers(-200, 200)),
    slip=st.tuples(st.integers(-36, 36), st.integers(-36, 36)),
)
def test_the_deviation_from_the_nominal_motion_is_found(
    workshop: Any, frame: PreparedFrame, nominal: tuple[int, int], slip: tuple[int, int]
) -> None:
    shift = (nominal[0] + slip[0], nominal[1] + slip[1])
    b = PreparedFrame(workshop.waves(7, finest=12.0, coarsest=150.0).picture(*SIZE, shift))
    found = find_shift(frame, b, box(nominal), np.array(nominal, dtype=float), REACH)
    assert isinstance(found, CoarseShift), found
    assert np.abs(found.px - slip).max() <= 2.0
    assert found.score > 0.5


def test_a_narrow_overlap_is_enough(workshop: Any, frame: PreparedFrame) -> None:
    b = PreparedFrame(workshop.waves(7, finest=12.0, coarsest=150.0).picture(*SIZE, (0, 400)))
    found = find_shift(frame, b, box((0, 390)), np.array([0.0, 390.0]), REACH)
    assert isinstance(found, CoarseShift), found
    assert found.px == pytest.approx([0, 10], abs=2)


def test_too_narrow_an_overlap_is_refused(frame: PreparedFrame) -> None:
    found = find_shift(frame, frame, (0, 470, 640, 480), np.array([0.0, -470.0]), REACH)
    assert isinstance(found, Failure)
    assert "640×10 px is too narrow" in found.reason


def test_an_empty_overlap_is_refused(workshop: Any, frame: PreparedFrame) -> None:
    g = np.random.default_rng(2)
    belt = PreparedFrame(workshop.digitised(20 + g.normal(0, 2, SIZE[::-1])))
    found = find_shift(belt, frame, (0, 0, 640, 300), np.array([0.0, 100.0]), REACH)
    assert isinstance(found, Failure)
    assert "the overlap is empty" in found.reason


def test_different_texture_does_not_fit(workshop: Any, frame: PreparedFrame) -> None:
    other = PreparedFrame(workshop.waves(8, finest=12.0, coarsest=40.0).picture(*SIZE))
    found = find_shift(frame, other, (0, 0, 640, 380), np.array([0.0, 100.0]), REACH)
    assert isinstance(found, Failure)
    assert "no place within ±40, ±40 px fits" in found.reason


@pytest.mark.parametrize("slip", [(-14, 9), (15, -15), (0, 0)])
def test_the_repetition_within_the_prior_is_taken(workshop: Any, slip: tuple[int, int]) -> None:
    y, x = np.mgrid[: SIZE[1], : SIZE[0]].astype(float)

    def pins(dx: float, dy: float) -> PreparedFrame:
        grey = 120 + 50 * np.cos(2 * np.pi * (x - dx) / 48) + 50 * np.cos(2 * np.pi * (y - dy) / 48)
        return PreparedFrame(workshop.digitised(grey))

    nominal = np.array([0.0, 144.0])
    found = find_shift(pins(0, 0), pins(slip[0], 144 + slip[1]), box((0, 144)), nominal, np.array([20.0, 20.0]))
    assert isinstance(found, CoarseShift)
    assert np.abs(found.px - slip).max() <= 2.0


@pytest.mark.parametrize(("template", "window"), [((5, 9), (11, 30)), ((24, 87), (40, 95)), ((7, 6), (7, 6))])
def test_correlations_are_those_of_opencv(template: tuple[int, int], window: tuple[int, int]) -> None:
    g = np.random.default_rng(3)
    t, w = (g.normal(0, 20, shape).astype(np.float32) for shape in (template, window))
    w[:, : window[1] // 3] = 0
    expected = np.nan_to_num(cv2.matchTemplate(w, t, cv2.TM_CCORR_NORMED), posinf=0.0, neginf=0.0)
    empty = np.array(
        [
            [not w[y : y + template[0], x : x + template[1]].any() for x in range(expected.shape[1])]
            for y in range(expected.shape[0])
        ]
    )
    found = correlations(t, w)
    assert not found[empty].any()
    assert found[~empty] == pytest.approx(expected[~empty], abs=2e-6)


def test_the_highest_maxima_are_listed_once_with_subsample_positions() -> None:
    y, x = np.mgrid[:30, :40].astype(float)
    hills = [(1.0, 11.3, 8.6), (0.9, 30.0, 20.25), (0.5, 4.5, 25.0)]
    surface = sum(h * np.exp(-((x - u) ** 2 + (y - v) ** 2) / 18) for h, u, v in hills).astype(np.float32)
    for most in (1, 2, 3, 5):
        found = best_peaks(surface, most)
        assert found == pytest.approx(np.array(hills[:most]), abs=0.05)
    assert best_peaks(np.zeros((3, 4), np.float32), 2) == pytest.approx(np.zeros((1, 3)))


def test_full_size_decides_between_several_peaks_of_half_size(workshop: Any) -> None:
    """A weave whose pattern repeats but for its finest strokes."""
    x = np.arange(float(SIZE[0]))
    fine = workshop.waves(9, finest=9.0, coarsest=16.0).levels(*SIZE) - 128
    weave = 60 * np.cos(2 * np.pi * x / 60)
    a = PreparedFrame(workshop.digitised(128 + weave + 0.8 * fine))
    b = PreparedFrame(workshop.digitised(np.roll(128 + weave + 0.8 * fine, (340, 60), (0, 1))))
    found = find_shift(a, b, (0, 0, 640, 140), np.array([0.0, 340.0]), np.array([70.0, 30.0]))
    assert isinstance(found, CoarseShift)
    assert found.px == pytest.approx([60, 0], abs=2)
