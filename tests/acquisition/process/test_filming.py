"""Filming without a station, and runs as recordings."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from vaoi_station.acquisition.process.filming import (
    FilmingHandlers,
    FilmingProcess,
    export_run,
    film,
    fire_steadily,
)
from vaoi_station.acquisition.process.messages import Command, FireOne, Grant, Ready, RunFinished, Trouble
from vaoi_station.acquisition.ring import Ring, RingLayout, ring_path
from vaoi_station.config import StationConfig
from vaoi_station.errors import GoneError, InputError
from vaoi_station.files import open_recording, read_calibration
from vaoi_station.model import RecordingHead
from vaoi_station.simulation import Twin, read_scenario

WIDTH, HEIGHT = 18, 16


FAULT = "[[faults.lost_frames]]\ncamera = 1\nrow = 2\n"

Make = Callable[..., StationConfig]


def test_filmed_boards_become_recordings_of_what_the_twin_showed(make_config: Make, tiny: str, tmp_path: Path) -> None:
    config = make_config(tiny + FAULT)
    kept: list[Path] = []

    def keep(finished: RunFinished, ring: Ring, generation: int) -> None:
        target = tmp_path / "kept" / finished.run
        if not kept:
            with pytest.raises(GoneError):
                export_run(target, finished, ring, generation - 1)
            with pytest.raises(FileNotFoundError):
                export_run(target, finished, ring, generation, {"board.json": tmp_path / "absent.json"})
            assert list(target.parent.iterdir()) == [], "nothing is left incomplete"
        export_run(target, finished, ring, generation, {"calibration.json": config.calibration})
        with pytest.raises(InputError, match="exists already"):
            export_run(target, finished, ring, generation)
        kept.append(target)

    notices: list[str] = []
    film(config, 4, FilmingHandlers(keep, notices.append))
    assert [k.name for k in kept] == ["001", "002", "003", "004"], "more runs than bays"
    assert any("Armed" in n for n in notices)
    assert config.simulation is not None
    twin = Twin(read_scenario(config.simulation.scenario))
    recording = open_recording(kept[0])
    head = twin.passage(0).head()
    assert recording.head.missing == ((1, 2),)
    assert recording.head.trigger_times_s == head.trigger_times_s
    assert (recording.head.model_extra or {})["x_verdicts"][0]["verdict"] == "missing"
    assert (recording.head.model_extra or {})["x_proof"]["proven"] is True
    assert np.array_equal(np.asarray(recording.frame(0, 3)), twin.passage(0).frame(0, 3))
    read_calibration(kept[0] / "calibration.json", cameras=2)
    assert list((tmp_path / "shm").iterdir()) == []
    assert [p.name for p in (tmp_path / "kept").iterdir() if p.name.startswith(".")] == []


def test_time_stamps_late_by_nearly_a_period_shift_no_row(make_config: Make, tiny: str) -> None:
    """The period is 50 ms: 48 ms late looks like 2 ms before the next pulse."""
    late_s = 0.048
    runs: list[RunFinished] = []
    config = make_config(tiny + f"[[faults.late_stamps]]\ncamera = 1\nby_s = {late_s}\n")
    assert config.simulation is not None
    twin = Twin(read_scenario(config.simulation.scenario))

    def finished(run: RunFinished, ring: Ring, generation: int) -> None:
        number = len(runs)
        runs.append(run)
        for frame in run.frames:
            assert frame.slot is not None, frame.cause
            shown = ring.snapshot(frame.slot, generation)
            assert np.array_equal(np.asarray(shown), twin.passage(number).frame(frame.camera, frame.row))

    film(config, 2, FilmingHandlers(finished, lambda _: None))
    for run in runs:
        assert run.proof is not None
        assert run.proof.proven
        assert run.head.doubts == ()
        assert run.head.missing == ()
        assert run.proof.cameras[1].latency_us == pytest.approx(late_s * 1e6, abs=2000)


def test_a_refused_pulse_is_requested_again_with_the_same_grant(make_config: Make) -> None:
    """The test plays the other end of the pipe: a controller whose LEDs must cool down after the first pulse."""
    config, results, received = make_config(), list[str](), list[Command]()
    head = RecordingHead.model_validate(
        {
            "format": "vaoi-recording", "version": 1, "cameras": [c.head for c in config.cameras], "rows": 1,
            "trigger_period_s": 0.05, "conveyor_mm_s": [0.0, 100.0],
        }
    )  # fmt: skip
    ours, theirs = multiprocessing.Pipe()

    def done(run: str) -> RunFinished:
        return RunFinished(run, 0, head, (), 0.0, "single")

    def play() -> None:
        theirs.send(Ready(2))
        for answer in (done("001"), Trouble("led-budget", "the LEDs must cool down.", "Wait."), done("002")):
            while not isinstance(command := theirs.recv(), FireOne):
                received.append(command)
            received.append(command)
            theirs.send(answer)

    with Ring.create(ring_path(config), RingLayout.of(config)) as ring:
        player = threading.Thread(target=play)
        player.start()
        handlers = FilmingHandlers(lambda run, *_: results.append(run.run), results.append)
        fire_steadily(FilmingProcess(ring, ours, handlers), 2, 0.01)
        player.join()
    assert results == ["001", "the LEDs must cool down. Wait.", "002"]
    assert received == [Grant("001", 0), FireOne(), Grant("002", 0), FireOne(), FireOne()]
