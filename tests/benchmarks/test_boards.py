"""Boards that benchmarks run on: from the twin and from recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vaoi_station.benchmarks.boards import BenchmarkBoard, board_from_recording
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.recording_writer import write_passage


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    write_passage(Twin(read_scenario(scenario_path("small"))).passage(0), tmp_path)
    return tmp_path


def test_recording_gives_the_same_board_as_the_twin(recording: Path, small_board: BenchmarkBoard) -> None:
    read = board_from_recording(recording)
    assert read.truth is None, "a truth file beside a recording is not read"
    assert read.frames.keys() == small_board.frames.keys()
    assert all(np.array_equal(read.frames[key], small_board.frames[key]) for key in small_board.frames)
    assert read.head.row_times_s() == pytest.approx(small_board.head.row_times_s())
