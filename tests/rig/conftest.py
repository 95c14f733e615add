"""Shared fixtures: the built firmware and emulator, and two rendered boards of the small scenario."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.needs import need_emulator
from tests.rig.known_boards import known_board
from vaoi_station.rig.chip import build
from vaoi_station.rig.rendering import RenderedBoard, render_boards
from vaoi_station.simulation import Scenario, read_scenario, scenario_path


@pytest.fixture(scope="session")
def small() -> Scenario:
    return read_scenario(scenario_path("small"))


@pytest.fixture(scope="session")
def boards(small: Scenario, tmp_path_factory: pytest.TempPathFactory) -> tuple[RenderedBoard, ...]:
    """Two boards."""
    return render_boards(small, [0, 1], tmp_path_factory.mktemp("rendered"), lambda _: None)


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    need_emulator()
    return build(tmp_path_factory.mktemp("rig") / "firmware")


@pytest.fixture
def known(tmp_path: Path) -> RenderedBoard:
    """A board of two cameras and six rows."""
    return known_board(tmp_path / "board")
