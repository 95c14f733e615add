"""The brightness of the board: sampled on the board alone, on made-up frames and on the twin."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.drift.checks import LampCheck
from vaoi_station.drift.lamps import measure_lamps, trimmed_mean
from vaoi_station.model import BoardType, RecordingHead, Status, Stitch

SIZE = 100
ROWS = 4
Matrix = tuple[tuple[float, ...], ...]
IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
BOARD = BoardType.model_validate({"name": "b", "outline": [[10, 10], [70, 370]]})


def moved(row: int) -> Matrix:
    """M_ij of a row: frames of 100 × 100 px at 1 px/mm follow one another along y."""
    return ((1.0, 0.0, 0.0), (0.0, 1.0, -float(SIZE * row)), (0.0, 0.0, 1.0))


def head(**keys: object) -> RecordingHead:
    camera = {"width": SIZE, "height": SIZE, "exposure_us": 100.0}
    return RecordingHead.model_validate(
        {
            "format": "vaoi-recording",
            "version": 1,
            "cameras": [camera],
            "rows": ROWS,
            "trigger_period_s": 0.1,
            "conveyor_mm_s": [0.0, 100.0],
            **keys,
        }
    )


def stitch(**keys: object) -> Stitch:
    matrices = [[moved(row) for row in range(ROWS)]]
    usual = {"method": "m", "image_matrices": matrices, "cad_matrix": IDENTITY, "row_motion": [], "status": Status.OK}
    return Stitch.model_validate({**usual, **keys})


def frames(*grey: float, dtype: type = np.uint8, beside: float = 250.0) -> dict[tuple[int, int], np.ndarray]:
    """One frame per grey level: the board has this level, what lies beside it another one."""
    made: dict[tuple[int, int], np.ndarray] = {}
    for row, level in enumerate(grey):
        y, x = np.mgrid[:SIZE, :SIZE] + np.array([SIZE * row, 0])[:, None, None]
        on = (x >= 10) & (x <= 70) & (y >= 10) & (y <= 370)
        scale = 1 if dtype is np.uint8 else 257
        made[0, row] = (np.where(on, level, beside) * scale).astype(dtype)
    return made


def lamps(pictures: dict[tuple[int, int], np.ndarray], **keys: object) -> tuple[LampCheck, ...]:
    return measure_lamps(stitch(), BOARD, head(**keys), lambda i, j: pictures.get((i, j)))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("beside", [0.0, 250.0])
def test_only_the_board_counts(dtype: type, beside: float) -> None:
    (lamp,) = lamps(frames(80, 80, 80, 80, dtype=dtype, beside=beside))
    assert (lamp.camera, lamp.light, lamp.exposure, lamp.grey) == (0, "", 100.0, 80.0)
    assert lamp.points > 4000


def test_lights_and_exposures_are_kept_apart() -> None:
    found = lamps(
        frames(80, 40, 90, 20),
        lights=["even", "left", "even", "even"],
        exposures_us=[[100.0], [100.0], [104.0], [25.0]],
        gains=[[1.0], [2.0], [1.0], [1.0]],
    )
    assert [(lamp.light, lamp.exposure) for lamp in found] == [("even", 25.0), ("even", 102.0), ("left", 200.0)]
    assert found[0].grey == 20.0
    assert 80 < found[1].grey < 90
    assert found[2].grey == 40.0


@given(st.lists(st.floats(0, 255), min_size=1, max_size=60), st.floats(0.01, 4))
def test_the_trimmed_mean_is_linear_within_the_range_and_ignores_the_order(values: list[float], factor: float) -> None:
    mean = trimmed_mean(np.array(values))
    assert min(values) - 1e-9 <= mean <= max(values) + 1e-9
    assert trimmed_mean(np.array(values) * factor) == pytest.approx(mean * factor, abs=1e-6)
    assert trimmed_mean(np.array(values)[::-1]) == pytest.approx(mean)
