"""A written passage reads back as the same recording."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from vaoi_station.files import open_recording
from vaoi_station.simulation import Twin
from vaoi_station.simulation.recording_writer import write_passage

Make = Callable[..., Twin]


@pytest.fixture
def twin(make: Make) -> Twin:
    return make(
        array={"cameras": 2, "distortion_px": 0.5, "px_per_mm": 5.0},
        faults={"lost_frames": [{"camera": 1, "row": 1}], "incomplete_frames": [{"camera": 0, "row": 2, "share": 0.5}]},
    )


def test_frames_that_arrive_whole_are_written_and_others_are_missing(twin: Twin, tmp_path: Path) -> None:
    passage = twin.passage(0)
    write_passage(passage, tmp_path)
    recording = open_recording(tmp_path)
    assert recording.head == passage.head()
    assert recording.head.missing == ((0, 2), (1, 1))
    for camera in range(2):
        for row in range(passage.rows):
            frame = recording.frame(camera, row)
            if (camera, row) in recording.head.missing:
                assert frame is None
            else:
                assert frame is not None
                assert np.array_equal(frame, passage.frame(camera, row))


def test_the_truth_is_written_only_if_wanted(twin: Twin, tmp_path: Path) -> None:
    passage = twin.passage(0)
    write_passage(passage, tmp_path / "with")
    write_passage(passage, tmp_path / "without", with_truth=False)
    truth = json.loads((tmp_path / "with" / "truth.json").read_text())
    assert truth == json.loads(json.dumps(passage.truth()))
    names = {path.name for path in (tmp_path / "without").iterdir()}
    assert names == {path.name for path in (tmp_path / "with").iterdir()} - {"truth.json"}
