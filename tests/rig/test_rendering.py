"""Rendered boards, and frames on demand."""

from __future__ import annotations

import multiprocessing
import os
import resource
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from vaoi_station.acquisition.controller.interface import TriggerPlan
from vaoi_station.acquisition.simulated import SimulatedBoard
from vaoi_station.errors import DeviceError
from vaoi_station.rig.faults import parse_fault, with_belt_faults
from vaoi_station.rig.rendering import RenderedBoard, render_boards
from vaoi_station.simulation import Scenario, Twin, read_scenario, scenario_path


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    """The small one, with a bounce that delays nothing and a frame that never arrives."""
    small = read_scenario(scenario_path("small"))
    return with_belt_faults(small, [parse_fault("bounce:board=1,at_s=0.1,for_s=0.001")])


@pytest.fixture(scope="module")
def made(scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> tuple[RenderedBoard, ...]:
    return render_boards(scenario, [0, 1], tmp_path_factory.mktemp("rendered"), lambda _: None)


def test_frames_are_those_of_the_simulated_station(scenario: Scenario, made: tuple[RenderedBoard, ...]) -> None:
    """Same edges, same pulses, same pixels as the in-process twin shows its controller and cameras."""
    twin = Twin(scenario)
    for rendered in made:
        board = SimulatedBoard(
            twin.passage(rendered.metadata.board), TriggerPlan.of(twin.line, scenario.line.lights), 2
        )
        assert list(rendered.metadata.edges) == board.edges
        assert list(rendered.metadata.pulses_s) == [pulse.time_s for pulse in board.pulses]
    rendered, passage = made[0], twin.passage(0)
    for camera, row in ((0, 0), (1, 3)):
        expected = passage.frame_at(camera, rendered.metadata.pulses_s[row], "ring", row)
        assert np.array_equal(rendered.map_frames()[row, camera], expected.reshape(-1))
    assert {(int(c), int(r)) for views in rendered.metadata.views.values() for c, r, _, _ in views} >= {(0, 1), (1, 1)}


def test_a_full_disk_is_reported_with_place_and_size(scenario: Scenario, tmp_path: Path) -> None:
    with (
        files_of_at_most(1_000_000),
        pytest.raises(DeviceError, match=r"frames\.raw: \d+ MB: File too large\. Free space"),
    ):
        render_boards(scenario, [0], tmp_path, lambda _: None)
    assert not list(tmp_path.rglob("*.raw"))


def test_ctrl_c_ends_the_rendering(scenario: Scenario, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """No process is left, and none writes a traceback."""

    def interrupt() -> None:
        while not multiprocessing.active_children():
            pass
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt).start()
    with pytest.raises(KeyboardInterrupt):
        render_boards(scenario, [0], tmp_path, lambda _: None)
    assert multiprocessing.active_children() == []
    assert capfd.readouterr().err == ""


@contextmanager
def files_of_at_most(size_bytes: int) -> Iterator[None]:
    """Limit the size of files, as a full disk does, for this process and those it starts."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
