"""The predicted uncertainty against the real error: a few boards here, thirty by `vaoi bench --consistency 30`."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

from vaoi_station.benchmarks.consistency import Run, together, twin_runs, varied
from vaoi_station.benchmarks.consistency_plot import draw


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    return list(twin_runs(6, first_seed=2000))


def made_up(seed: int, real: float, said: float, views: int = 4000) -> Run:
    g = np.random.default_rng(seed)
    covariance = np.tile(np.diag([said**2, 4 * said**2]), (views, 1, 1))
    error = g.normal(0, 1, (views, 2)) * (real, 2 * real)
    return Run("made up", "ok", error, covariance, np.zeros(0), np.zeros(0))


@pytest.mark.parametrize(("real", "normalised"), [(0.01, 1.0), (0.02, 4.0), (0.005, 0.25)])
def test_the_measure_is_one_where_the_covariance_is_that_of_the_errors(real: float, normalised: float) -> None:
    run = made_up(1, real, said=0.01)
    assert run.normalised == pytest.approx(normalised, rel=0.05)
    assert run.rms_px == pytest.approx(run.predicted_rms_px * np.sqrt(normalised), rel=0.03)
    figures = together([run, made_up(2, 0.01, 0.01)])
    assert figures.normalised_mean == pytest.approx((normalised + 1) / 2, rel=0.05)
    if normalised == 1:
        assert figures.beyond_three == pytest.approx(np.exp(-4.5), abs=0.004)


def test_predicted_and_real_errors_of_the_twin_agree(runs: list[Run]) -> None:
    """Six runs of the measure's thirty: their mean scatters by a third or so about what thirty give."""
    figures = together(runs)
    print(figures)
    assert figures.failed == 0
    assert 0.4 < figures.normalised_mean < 2.0
    assert figures.worst < 6
    assert figures.surface_normalised is not None
    assert 0.2 < figures.surface_normalised < 4.0
    assert max(r.rms_px for r in runs) < 0.05


def test_boards_differ_in_all_that_may_differ() -> None:
    one, other = varied(1), varied(2)
    assert one == varied(1)
    for section in ("array", "belt", "board"):
        a, b = getattr(one, section), getattr(other, section)
        assert sum(getattr(a, k) != getattr(b, k) for k in type(a).model_fields) >= 5, section
    assert one.lights != other.lights


def test_the_drawing_shows_every_run(runs: list[Run]) -> None:
    drawn = ElementTree.fromstring(draw(runs, [made_up(1, 0.01, 0.01)]))
    circles = drawn.findall(".//{http://www.w3.org/2000/svg}circle")
    assert len(circles) == len(runs) + 1
