"""The small simulated board, stitched once."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from vaoi_station.files import Recording
from vaoi_station.geometry import Camera
from vaoi_station.model import BoardType, Component, Stitch
from vaoi_station.rendering import ViewCalculator
from vaoi_station.simulation.recording_writer import write_passage
from vaoi_station.simulation.scenario_files import read_scenario, scenario_path
from vaoi_station.simulation.twin import Twin
from vaoi_station.stitching.recordings.opening import open_run
from vaoi_station.stitching.work import stitch_frames


@dataclass(frozen=True)
class StitchedBoard:
    """A recording with its result."""

    recording: Recording
    board_type: BoardType
    cameras: tuple[Camera, ...]
    stitch: Stitch


@pytest.fixture(scope="session")
def small_board(tmp_path_factory: pytest.TempPathFactory) -> StitchedBoard:
    directory = tmp_path_factory.mktemp("small")
    write_passage(Twin(read_scenario(scenario_path("small"))).passage(0), directory, with_truth=False)
    opened = open_run(directory)
    stitch = stitch_frames(opened.setup, opened.recording.head, opened.recording.frame)
    board_type = opened.setup.board_type
    assert board_type is not None
    return StitchedBoard(opened.recording, board_type, tuple(opened.setup.cameras), stitch)


@pytest.fixture(scope="session")
def small_views(small_board: StitchedBoard) -> tuple[ViewCalculator, Component]:
    part = small_board.board_type.component("U1")
    assert part is not None
    return ViewCalculator(small_board.board_type, small_board.stitch, small_board.cameras), part
