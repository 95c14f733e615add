"""Detection of dim lights in made-up runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.drift.checks import LampCheck, RunCheck
from vaoi_station.drift.lamp_watch import (
    BASELINE_RUNS,
    BRIGHT_RUNS,
    DIM_RUNS,
    DIM_SHARE,
    DimLamp,
    find_dim_lamps,
    only_baselines,
    with_baselines,
)

Made = Callable[..., RunCheck]
STILL = (0.0, 0.0, 0.0)


def found_in(runs: Sequence[RunCheck]) -> tuple[DimLamp, ...]:
    """Find dim lights in runs that arrive one after another."""
    watched: list[RunCheck] = []
    for check in runs:
        watched.append(with_baselines(check, watched))
    return find_dim_lamps(watched)


def lamp(camera: int, grey: float, light: str = "even", exposure: float = 200.0, points: int = 1000) -> LampCheck:
    return LampCheck(camera=camera, light=light, exposure=exposure, grey=grey, points=points)


@pytest.fixture(scope="session")
def run(made: Made) -> Made:
    def make(k: int, *lamps: LampCheck, board_type: str = "a") -> RunCheck:
        return made(k, [STILL, STILL], board_type=board_type).model_copy(update={"lamps": lamps})

    return make


def series(run: Made, *grey: float) -> list[RunCheck]:
    """Runs in which camera 1 has these grey levels under the light left; all else stays as it is."""
    same = lamp(0, 80), lamp(1, 80), lamp(0, 60, "left")
    return [run(k, *same, lamp(1, g, "left")) for k, g in enumerate(grey)]


def test_a_dim_light_is_reported_with_camera_share_and_first_run(run: Made) -> None:
    runs = series(run, *[60.0] * 7, *[24.0] * DIM_RUNS)
    assert found_in(runs[:-1]) == ()
    (found,) = found_in(runs)
    assert (found.light, found.cameras, found.runs) == ("left", (1,), 3)
    assert (found.since_run, found.since_time) == ("r007", "t007")
    assert found.share == pytest.approx(0.4)
    assert not found.everywhere


def test_the_warning_ends_when_the_light_is_mended(run: Made) -> None:
    grey = [60.0] * 5 + [20.0] * 5
    assert found_in(series(run, *grey))
    assert found_in(series(run, *grey, 60.0)), "one bright board is no repair"
    assert found_in(series(run, *grey, *[60.0] * BRIGHT_RUNS)) == ()


def test_a_light_that_fails_entirely_is_dim_with_its_first_board(run: Made) -> None:
    (found,) = found_in(series(run, *[60.0] * 5, 1.0))
    assert (found.light, found.cameras, found.since_run, found.runs) == ("left", (1,), "r005", 1)
    (found,) = found_in(series(run, *[60.0] * 5, 48.0, 1.0))
    assert (found.since_run, found.runs) == ("r005", 2)


def test_slow_ageing_is_reported_once_it_is_beyond_the_limit(run: Made) -> None:
    grey = [60.0 * 0.99**k for k in range(60)]
    first = next(k for k in range(61) if found_in(series(run, *grey[:k])))
    assert grey[first - DIM_RUNS] < 60 * DIM_SHARE
    assert first < 25


@pytest.mark.parametrize(("share", "reported"), [(0.85, False), (0.75, True)])
def test_boards_that_are_a_little_darker_under_all_lights_are_not_reported(
    run: Made, share: float, reported: bool
) -> None:
    """Another lot of solder mask changes all lights in all cameras alike."""
    factors = [1.0] * 6 + [share] * 4
    runs = [run(k, lamp(0, 80 * f), lamp(1, 60 * f), lamp(1, 90 * f, "left")) for k, f in enumerate(factors)]
    assert [found.everywhere for found in found_in(runs)] == [True, True] * reported


def test_every_board_type_has_a_baseline_and_shows_a_dim_light_for_itself(run: Made) -> None:
    usual = [run(k, lamp(0, (80.0, 30.0)[k % 2]), board_type="ab"[k % 2]) for k in range(2 * BASELINE_RUNS + 10)]
    assert not any(found_in(usual[:k]) for k in range(len(usual) + 1)), "types differ in brightness"
    dark = [run(k, lamp(0, (40.0, 15.0)[k % 2]), board_type="ab"[k % 2]) for k in range(20, 26)]
    assert found_in(usual + dark[:4]) == ()
    (found,) = found_in(usual + dark[:5])
    assert (found.cameras, found.runs, found.since_run) == ((0,), 3, "r020")
    (found,) = found_in(usual + dark)
    assert (found.cameras, found.runs, found.since_run, found.everywhere) == ((0,), 6, "r020", True)


@pytest.mark.parametrize("odd", [(4.0,), (12.0, 8.0), (200.0,)])
def test_an_odd_first_board_does_not_hide_an_unplugged_led(run: Made, odd: tuple[float, ...]) -> None:
    (found,) = found_in(series(run, *odd, *[60.0] * (BASELINE_RUNS - len(odd)), 1.0))
    assert (found.light, found.cameras, found.runs) == ("left", (1,), 1)


@pytest.mark.parametrize("first", [60.0, 20.0])
def test_a_light_that_lost_15_percent_is_reported_also_after_an_odd_first_board(run: Made, first: float) -> None:
    (found,) = found_in(series(run, first, 60.6, 59.5, 60.2, 60.0, *[51.0] * DIM_RUNS))
    assert (found.light, found.cameras) == ("left", (1,))


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.floats(5, 200))
def test_scatter_of_three_percent_is_not_dimness(run: Made, seed: int, level: float) -> None:
    g = np.random.default_rng(seed)
    factors = np.clip(g.normal(1, 0.03, (40, 2)), 0.9, 1.1)
    runs = [run(k, *(lamp(i, level * float(f)) for i, f in enumerate(both))) for k, both in enumerate(factors)]
    assert found_in(runs) == ()


def test_a_baseline_outlives_the_runs_it_was_made_from(run: Made) -> None:
    watched: list[RunCheck] = []
    for k in range(60):
        watched.append(with_baselines(run(k, lamp(0, 80.0 if k < 8 else 30.0)), watched[-10:]))
    (found,) = find_dim_lamps(watched[-20:])
    assert found.share == pytest.approx(30 / 80)
    again = RunCheck.model_validate_json(watched[-1].model_dump_json())
    assert again == watched[-1]


def test_the_latest_baselines_of_lights_are_kept_if_a_run_does_not_show_them(run: Made) -> None:
    watched: list[RunCheck] = []
    for k in range(7):
        watched.append(with_baselines(run(k, lamp(0, 80.0), lamp(1, 60.0)), watched))
    assert only_baselines(watched[0], None).lamps == ()
    kept = only_baselines(with_baselines(run(7, lamp(1, 61.0), lamp(1, 9.0, "new")), watched), watched[-1])
    assert kept.board_type == "a"
    assert [(one.camera, one.light, one.grey) for one in kept.lamps] == [(1, "even", 61.0), (0, "even", 80.0)]
    later = with_baselines(run(8, lamp(0, 40.0), lamp(1, 30.0)), [kept])
    assert [one.baseline.brightness for one in later.lamps if one.baseline] == [0.4, 0.3]
