"""Boards that benchmarks run on: from the twin and from recordings."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vaoi_station.benchmarks.boards import BenchmarkBoard, board_from_recording
from vaoi_station.errors import NotFoundError
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.recording_writer import write_passage
from vaoi_station.stitching.expectation import turned_by


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    write_passage(Twin(read_scenario(scenario_path("small"))).passage(0), tmp_path)
    return tmp_path


def test_board_of_the_twin_has_all_frames_and_its_truth(small_board: BenchmarkBoard) -> None:
    assert small_board.name == "small"
    assert sorted(small_board.frames) == [(i, j) for i in range(2) for j in range(6)]
    assert small_board.truth is not None
    assert small_board.truth["views"].keys() <= {c.address for c in small_board.board_type.components}


def test_setup_knows_the_lights_and_the_rotation_of_a_recording(small_board: BenchmarkBoard) -> None:
    """Without its lights, a recording under lamps in turn was off by 0.3 px in benchmarks only."""
    head = small_board.head.model_copy(update={"lights": ("even", "left") * 3, "rotation_deg": 180})
    setup = replace(small_board, head=head).setup
    assert setup.lights == head.lights
    assert setup.expectation == turned_by(180)


def test_recording_gives_the_same_board_as_the_twin(recording: Path, small_board: BenchmarkBoard) -> None:
    read = board_from_recording(recording)
    assert read.truth is None, "a truth file beside a recording is not read"
    assert read.frames.keys() == small_board.frames.keys()
    assert all(np.array_equal(read.frames[key], small_board.frames[key]) for key in small_board.frames)
    assert read.head.row_times_s() == pytest.approx(small_board.head.row_times_s())


def test_missing_frames_of_a_recording_are_absent(recording: Path, small_board: BenchmarkBoard) -> None:
    head = json.loads((recording / "recording.json").read_text())
    (recording / "recording.json").write_text(json.dumps(head | {"missing": [[1, 2]]}))
    assert board_from_recording(recording).frames.keys() == small_board.frames.keys() - {(1, 2)}


def test_recording_without_a_board_type_is_refused(recording: Path) -> None:
    (recording / "board.json").unlink()
    with pytest.raises(NotFoundError, match=r"board\.json"):
        board_from_recording(recording)
