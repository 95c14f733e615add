"""What a run says when a camera behaves as no camera should: real Aravis and a whole acquisition process."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.acquisition.cameras.aravis.stand_in import camera_config, station_config
from tests.acquisition.cameras.aravis.wire.stage import HEIGHT, WIDTH, noise
from tests.acquisition.conftest import Bench
from tests.gige.camera import Camera
from tests.gige.line import ScriptedController
from vaoi_station.acquisition.cameras.aravis.camera import open_aravis_cameras
from vaoi_station.acquisition.devices import Devices
from vaoi_station.acquisition.pairing.evidence import NO_PACKET
from vaoi_station.acquisition.process.messages import Health, Ready, RunFinished, Trouble
from vaoi_station.model import FrameRecord, Verdict

Open = Callable[[], "Line"]
PIXELS = noise(1).tobytes()
PERIOD_S = 0.1


class Line:
    """The acquisition process of a station with a scripted camera."""

    def __init__(self, directory: Path, camera: Camera) -> None:
        self.camera = camera
        self.controller = ScriptedController()
        config = station_config(
            directory, [camera_config(name="c0", address=camera.address, width=WIDTH, height=HEIGHT)], PERIOD_S
        )
        self.bench = Bench(config, lambda _: Devices(open_aravis_cameras(config), self.controller))
        self.bench.until(Ready)
        self.bench.arm(3)
        self._pace = threading.Event()

    def film(self, before: Callable[[int], object] = lambda _row: None, rows: int = 8) -> RunFinished:
        """Film a board; `before(row)` is called before each pulse but the first."""

        def expose(row: int, edge_ns: int) -> None:
            if row >= 0:
                self.camera.expose(PIXELS, edge_ns=edge_ns)
                before(row + 1)
            # In row −1 the cameras get their slots.
            self._pace.wait(PERIOD_S)

        self.controller.board(rows, expose)
        return self.bench.until(RunFinished)

    def wait_for_camera(self) -> None:
        """Wait until the camera was opened again after a board of which it sent nothing."""
        while True:
            [health] = self.bench.until(Health).cameras
            if health.connected and health.recovery is not None and self.camera.armed:
                return


@pytest.fixture
def line(tmp_path: Path) -> Iterator[Open]:
    """Open the line of one scripted camera."""
    camera = Camera("127.0.0.2")
    lines: list[Line] = []

    def begin() -> Line:
        lines.append(Line(tmp_path, camera))
        return lines[-1]

    yield begin
    for opened in lines:
        opened.bench.close()
    camera.close()


def faults(done: RunFinished) -> dict[int, FrameRecord]:
    return {frame.row: frame for frame in done.frames if not frame.usable}


def size_of_jump(text: str) -> float:
    found = re.search(r"its clock jumped by ([+-][0-9.]+) s", text)
    assert found, text
    return float(found[1])


@pytest.mark.parametrize("jump_s", [-1.0, 37.0, 0.1])
def test_a_clock_that_jumps_in_a_run_costs_the_frames_of_that_moment_and_is_named(line: Open, jump_s: float) -> None:
    """PTP: a clock that is set to its master's time, or from UTC to TAI."""
    station = line()
    assert faults(station.film()) == {}

    def jump(row: int) -> None:
        if row == 4:
            station.camera.clock_offset_ns += round(jump_s * 1e9)
        elif row == 7:
            station.bench.until(Trouble)

    done = station.film(jump)
    bad = faults(done)
    assert bad
    for frame in bad.values():
        assert size_of_jump(frame.cause) == pytest.approx(jump_s, abs=0.05)
    assert 7 not in bad, "frames after the next reading of the clock are good again"
    assert done.proof is not None
    assert {finding.kind for finding in done.proof.findings} <= {"clock-jumped", "ignored-trigger"}
    [trouble] = station.bench.of(Trouble)
    assert (trouble.code, "PTP" in trouble.action) == ("clock-jumped", True)
    assert size_of_jump(trouble.message) == pytest.approx(jump_s, abs=0.05)
    assert faults(station.film()) == {}, "the next board is not affected"


def test_a_firewall_that_drops_all_frames_is_named(line: Open) -> None:
    station = line()
    station.camera.faults.path_bytes = 0
    done = station.film()
    assert {frame.verdict for frame in done.frames} == {Verdict.MISSING}
    assert {frame.cause for frame in done.frames} == {NO_PACKET}
    station.camera.faults.path_bytes = 65535
    # A camera that sent nothing of a board is opened again, since a firewall looks like a camera that hangs.
    station.wait_for_camera()
    assert faults(station.film()) == {}
    station.camera.faults.path_bytes = 0
    assert "the camera sent no frame in this run" in station.film().frames[0].cause, "packets have come before"
