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
from vaoi_station.acquisition.simulated import SimulatedBoard, to_bytes
from vaoi_station.errors import DeviceError, InternalError
from vaoi_station.rig.faults import parse_fault, with_belt_faults
from vaoi_station.rig.rendering import FrameRenderer, FrameRequest, RenderedBoard, render_boards
from vaoi_station.simulation import Scenario, Twin, calibration_board, read_scenario, scenario_path


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


def test_a_board_is_rendered_once_whatever_faults_other_boards_have(
    scenario: Scenario, made: tuple[RenderedBoard, ...]
) -> None:
    folder, messages = made[0].directory.parent, list[str]()
    when = made[0].frames_path.stat().st_mtime_ns
    other = with_belt_faults(scenario, [parse_fault("stuck:board=1,row=2")])
    again = render_boards(other, [0], folder, messages.append)
    assert (again, messages, made[0].frames_path.stat().st_mtime_ns) == (made[:1], [], when)
    (made[1].directory / "film.json").unlink()
    assert not made[1].complete
    assert render_boards(scenario, [0, 1], folder, messages.append) == made
    assert messages == ["Rendering 1 board(s) of 60 × 40 mm."]


def test_other_boards_have_other_frames(scenario: Scenario, made: tuple[RenderedBoard, ...], tmp_path: Path) -> None:
    assert made[0].directory != made[1].directory
    assert not np.array_equal(made[0].map_frames()[2, 0], made[1].map_frames()[2, 0])


def test_a_full_disk_is_reported_with_place_and_size(scenario: Scenario, tmp_path: Path) -> None:
    with (
        files_of_at_most(1_000_000),
        pytest.raises(DeviceError, match=r"frames\.raw: \d+ MB: File too large\. Free space"),
    ):
        render_boards(scenario, [0], tmp_path, lambda _: None)
    assert not list(tmp_path.rglob("*.raw"))


def test_a_file_is_refused_as_a_directory(scenario: Scenario, tmp_path: Path) -> None:
    (tmp_path / "rendered").write_text("")
    with pytest.raises(DeviceError, match=r"rendered boards cannot be stored: .*: Not a directory\. .*another --films"):
        render_boards(scenario, [0], tmp_path / "rendered", lambda _: None)


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


@pytest.fixture
def renderer(small: Scenario, tmp_path: Path) -> Iterator[FrameRenderer]:
    room = FrameRenderer(small, tmp_path / "late")
    yield room
    room.close()


def test_a_frame_on_demand_equals_the_rendered_one(renderer: FrameRenderer, boards: tuple[RenderedBoard, ...]) -> None:
    metadata = boards[1].metadata
    path = renderer.render(FrameRequest(1, metadata.pulses_s[2], "ring", 2))
    assert np.array_equal(np.fromfile(path, np.uint8), boards[1].map_frames()[2].reshape(-1))
    other = renderer.render(FrameRequest(1, metadata.pulses_s[2] + 0.001, "ring", 2))
    assert other != path
    assert not np.array_equal(np.fromfile(other, np.uint8), boards[1].map_frames()[2].reshape(-1))


def test_the_calibration_board_is_rendered_once(renderer: FrameRenderer, small: Scenario) -> None:
    path = renderer.render(FrameRequest(None))
    expected = np.concatenate([to_bytes(image) for _, _, image in calibration_board.frames(Twin(small))])
    assert np.array_equal(np.fromfile(path, np.uint8), expected)
    assert renderer.render(FrameRequest(None)) == path


def test_a_renderer_that_has_ended_is_reported(small: Scenario, tmp_path: Path) -> None:
    room = FrameRenderer(small, tmp_path / "late")
    with pytest.raises(InternalError, match="renders frames on demand has ended"):
        room.render(FrameRequest(0, 0.3, "no such light"))
    room.close()
