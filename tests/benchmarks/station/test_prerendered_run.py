"""Boards rendered beforehand: content, reuse, interrupted rendering."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vaoi_station.benchmarks.station.prerendered_run import PrerenderedRun, prerender
from vaoi_station.simulation import Scenario, Twin


def test_frames_and_documents_are_those_of_the_twin(small_run: PrerenderedRun, scenario: Scenario) -> None:
    passage, frames = Twin(scenario).passage(0), small_run.map()
    assert frames.shape == (passage.rows, 2, 480, 640)
    for camera, row in ((0, 0), (1, 3)):
        assert np.array_equal(frames[row, camera], passage.frame(camera, row))
    assert small_run.head == passage.head()
    assert small_run.line == passage.twin.line
    assert small_run.board_type == passage.twin.board_type
    assert len(small_run.calibration.cameras(small_run.head.cameras)) == 2


def test_mapped_frames_cannot_be_written(small_run: PrerenderedRun) -> None:
    with pytest.raises(ValueError, match="read-only"):
        small_run.map()[0, 0, 0, 0] = 1


def test_same_scenario_is_rendered_once_and_another_one_again(scenario: Scenario, tmp_path: Path) -> None:
    steps: list[str] = []
    prerender(scenario, tmp_path, steps.append)
    prerender(scenario, tmp_path, steps.append)
    assert len(steps) == 2
    other = scenario.model_copy(update={"belt": scenario.belt.model_copy(update={"seed": 99})})
    prerender(other, tmp_path, steps.append)
    assert len(steps) == 4


def test_interrupted_rendering_is_not_reused(scenario: Scenario, tmp_path: Path) -> None:
    def interrupt(step: str) -> None:
        if step.startswith("Rendering"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        prerender(scenario, tmp_path, interrupt)
    steps: list[str] = []
    run = prerender(scenario, tmp_path, steps.append)
    assert len(steps) == 2
    assert run.map().any()
