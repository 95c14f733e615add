from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from vaoi_station.geometry.robust import Failure
from vaoi_station.stitching.coarse import CoarseShift, find_shift
from vaoi_station.stitching.prepare import Prepared

SIZE = (640, 480)
REACH = np.array([40.0, 40.0])


def box(shift: tuple[float, float]) -> tuple[int, int, int, int]:
    """The part of frame a that is still in frame b after a shift of the content."""
    x, y = (round(v) for v in shift)
    return max(0, -x), max(0, -y), min(SIZE[0], SIZE[0] - x), min(SIZE[1], SIZE[1] - y)


@pytest.fixture(scope="module")
def frame(workshop: Any) -> Prepared:
    return Prepared(workshop.waves(7, finest=12.0, coarsest=150.0).picture(*SIZE))


@settings(max_examples=8, deadline=None, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(
    nominal=st.tuples(st.integers(-200, 200), st.integers(-200, 200)),
    slip=st.tuples(st.integers(-36, 36), st.integers(-36, 36)),
)
def test_what_the_belt_did_beyond_its_nominal_motion(
    workshop: Any, frame: Prepared, nominal: tuple[int, int], slip: tuple[int, int]
) -> None:
    shift = (nominal[0] + slip[0], nominal[1] + slip[1])
    b = Prepared(workshop.waves(7, finest=12.0, coarsest=150.0).picture(*SIZE, shift))
    found = find_shift(frame, b, box(nominal), np.array(nominal, dtype=float), REACH)
    assert isinstance(found, CoarseShift), found
    assert np.abs(found.px - slip).max() <= 2.0
    assert found.score > 0.5


def test_a_narrow_overlap_is_enough(workshop: Any, frame: Prepared) -> None:
    b = Prepared(workshop.waves(7, finest=12.0, coarsest=150.0).picture(*SIZE, (0, 400)))
    found = find_shift(frame, b, box((0, 390)), np.array([0.0, 390.0]), REACH)
    assert isinstance(found, CoarseShift), found
    assert found.px == pytest.approx([0, 10], abs=2)


def test_too_narrow_an_overlap_says_so(frame: Prepared) -> None:
    found = find_shift(frame, frame, (0, 470, 640, 480), np.array([0.0, -470.0]), REACH)
    assert isinstance(found, Failure)
    assert "640×10 px is too narrow" in found.reason


def test_an_empty_overlap_says_so(workshop: Any, frame: Prepared) -> None:
    g = np.random.default_rng(2)
    belt = Prepared(workshop.digitised(20 + g.normal(0, 2, SIZE[::-1])))
    found = find_shift(belt, frame, (0, 0, 640, 300), np.array([0.0, 100.0]), REACH)
    assert isinstance(found, Failure)
    assert "the overlap is empty" in found.reason


def test_other_texture_does_not_fit(workshop: Any, frame: Prepared) -> None:
    other = Prepared(workshop.waves(8, finest=12.0, coarsest=40.0).picture(*SIZE))
    found = find_shift(frame, other, (0, 0, 640, 380), np.array([0.0, 100.0]), REACH)
    assert isinstance(found, Failure)
    assert "no place within ±40, ±40 px fits" in found.reason


@pytest.mark.parametrize("slip", [(-14, 9), (15, -15), (0, 0)])
def test_of_repeating_places_the_one_within_the_prior_is_taken(workshop: Any, slip: tuple[int, int]) -> None:
    y, x = np.mgrid[: SIZE[1], : SIZE[0]].astype(float)

    def pins(dx: float, dy: float) -> Prepared:
        grey = 120 + 50 * np.cos(2 * np.pi * (x - dx) / 48) + 50 * np.cos(2 * np.pi * (y - dy) / 48)
        return Prepared(workshop.digitised(grey))

    nominal = np.array([0.0, 144.0])
    found = find_shift(pins(0, 0), pins(slip[0], 144 + slip[1]), box((0, 144)), nominal, np.array([20.0, 20.0]))
    assert isinstance(found, CoarseShift)
    assert np.abs(found.px - slip).max() <= 2.0
