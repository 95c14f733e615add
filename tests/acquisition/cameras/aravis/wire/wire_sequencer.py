"""Exposure and gain row by row by the camera's sequencer: real Aravis, a scripted camera, and whole runs."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.acquisition.cameras.aravis.stand_in import camera_config, station_config
from tests.acquisition.cameras.aravis.wire.stage import HEIGHT, WIDTH
from tests.acquisition.conftest import Bench
from tests.gige.camera import Camera
from tests.gige.line import ScriptedController
from vaoi_station.acquisition.cameras.aravis.camera import open_aravis_cameras
from vaoi_station.acquisition.cameras.interface import CameraExposure
from vaoi_station.acquisition.controller.interface import TriggerPlan
from vaoi_station.acquisition.devices import Devices
from vaoi_station.acquisition.process.messages import Arm, Armed, Ready, RunFinished, Trouble
from vaoi_station.errors import DeviceError
from vaoi_station.model import ProgramRow

PERIOD_S, START_S, BAYS, MOST_FILMS = 0.1, 0.4, 3, 6
SENT_TOO_SLOWLY = "parts of the frame did not arrive in time"
SCENE = np.random.default_rng(1).integers(5, 60, WIDTH * HEIGHT, dtype=np.uint8)
STEPS = ((300.0, 0.0), (100.0, 0.0), (100.0, 6.0))
FACTORS = (3.0, 1.0, 10**0.3)


def program(*steps: tuple[float, float]) -> tuple[ProgramRow, ...]:
    return tuple(ProgramRow("", (exposure_us,), (gain_db,)) for exposure_us, gain_db in steps)


class Line:
    """The acquisition process of a station with a scripted camera that has a sequencer."""

    def __init__(self, directory: Path, camera: Camera) -> None:
        self.camera, self.controller = camera, ScriptedController()
        content = {"name": "c0", "address": camera.address, "width": WIDTH, "height": HEIGHT}
        config = station_config(directory, [camera_config(**content, exposure_by="sequencer")], PERIOD_S)
        self.bench = Bench(config, lambda _: Devices(open_aravis_cameras(config), self.controller))
        self.bench.until(Ready)
        for bay in range(BAYS):
            self.bench.grant(f"run {bay}", bay)
        self._films = 0
        self._pace = threading.Event()

    def arm(self, *steps: tuple[float, float]) -> None:
        plan = replace(TriggerPlan.of(self.bench.config.line), program=program(*steps), start_delay_s=START_S)
        self.bench.send(Arm(plan))

    def film(self, rows: int, ignored: int | None = None) -> RunFinished:
        """Film a board; the camera does not answer the pulse of row `ignored`.

        The camera sends from a thread of this process. On a busy machine it may rest between two packets of a frame
        for longer than Aravis waits; the board then passes once more.
        """
        done = self._pass(rows, ignored)
        while self._films < MOST_FILMS and any(SENT_TOO_SLOWLY in frame.cause for frame in done.frames):
            done = self._pass(rows, ignored)
        return done

    def _pass(self, rows: int, ignored: int | None) -> RunFinished:
        if self._films:  # the frames of the board before have been compared
            self.bench.grant(f"run {self._films + BAYS - 1}", (self._films - 1) % BAYS)
        self._films += 1

        def expose(row: int, edge_ns: int) -> None:
            if row not in (-1, ignored):
                self.camera.film(SCENE.tobytes(), edge_ns)
            # In row −1 the cameras get their slots, and their sequencers begin anew.
            self._pace.wait(PERIOD_S if row >= 0 else START_S)

        self.controller.board(rows, expose)
        return self.bench.until(RunFinished)


@pytest.fixture
def camera() -> Iterator[Camera]:
    camera = Camera("127.0.0.2", sequencer=True)
    yield camera
    camera.close()


@pytest.fixture
def line(tmp_path: Path, camera: Camera) -> Iterator[Callable[[], Line]]:
    """Open the line of the camera."""
    lines: list[Line] = []

    def begin() -> Line:
        lines.append(Line(tmp_path, camera))
        return lines[-1]

    yield begin
    for opened in lines:
        opened.bench.close()


def test_every_board_begins_with_the_first_step_and_every_frame_is_as_bright_as_its_row(
    line: Callable[[], Line],
) -> None:
    """Seven rows of a program of three steps: the next board would begin with the second step."""
    station = line()
    station.arm(*STEPS)
    station.bench.until(Armed)
    for _ in range(2):
        done = station.film(7)
        assert [(f.usable, f.cause) for f in done.frames] == [(True, "")] * 7
        for frame in done.frames:
            assert frame.slot is not None
            expected = np.rint(SCENE * FACTORS[frame.row % 3]).clip(0, 255)
            assert np.abs(station.bench.ring.memory(frame.slot) - expected).max() <= 1
        assert [(f.exposure_us, round(f.gain or 0.0, 3)) for f in done.frames[:3]] == [
            (300.0, 1.0), (100.0, 1.0), (100.0, 1.995),
        ]  # fmt: skip


def test_frames_behind_a_pulse_that_the_camera_ignored_are_not_proven(line: Callable[[], Line]) -> None:
    station = line()
    station.arm(*STEPS)
    station.bench.until(Armed)
    done = station.film(6, ignored=2)
    causes = {frame.row: frame.cause for frame in done.frames}
    assert [frame.row for frame in done.frames if frame.usable] == [0, 1], causes
    assert "the light program has 300 µs: the camera's sequencer is at another row" in causes[3]
    assert "its frame states an exposure of 300 µs, but the light program has 100 µs" in causes[4]
    assert "its frame states a gain of 0 dB, but the light program has 6 dB" in causes[5]
    assert done.proof is not None
    assert not done.proof.proven
    assert all(frame.usable for frame in station.film(6).frames), "the next board begins anew"


def test_what_the_camera_cannot_hold_is_refused_and_another_program_is_taken(line: Callable[[], Line]) -> None:
    station = line()
    station.arm(*((100.0 * n, 0.0) for n in range(1, 6)))
    trouble = station.bench.until(Trouble)
    assert trouble.code == "sequencer-limits"
    assert "its sequencer holds 4 sets, but the light program needs 5" in trouble.message
    station.arm((700.0, 0.0))
    station.bench.until(Armed)
    station.camera.sequencer.forgets_saving = True
    station.arm(*STEPS)
    assert station.bench.until(Trouble).code == "setting-ignored"
    station.camera.sequencer.forgets_saving = False
    station.arm((700.0, 0.0))
    station.bench.until(Armed)
    assert station.camera.value("ExposureTime") == 700, "what the refused program wrote is overwritten"
    # Steps that repeat need one turn only, and equal ones no sequencer.
    for steps in (((100.0, 0.0), (200.0, 0.0)) * 3, ((100.0, 0.0),) * 6):
        station.arm(*steps)
        station.bench.until(Armed)
        assert station.camera.sequencer.on is (len(set(steps)) > 1)


def test_a_camera_without_a_sequencer_is_refused(tmp_path: Path, camera: Camera) -> None:
    with_chunks = Camera("127.0.0.3", chunks=True)
    try:
        content = {"name": "c0", "width": WIDTH, "height": HEIGHT, "exposure_by": "sequencer"}
        config = station_config(tmp_path, [camera_config(address=with_chunks.address, **content)])
        (opened,) = open_aravis_cameras(config)
        try:
            with pytest.raises(DeviceError, match="has no sequencer") as caught:
                opened.set_exposure(CameraExposure((300.0, 100.0), 0.0, sequence=STEPS[:2]))
            assert caught.value.code == "sequencer-absent"
        finally:
            opened.close()
    finally:
        with_chunks.close()
