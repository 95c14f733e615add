"""Replayed recordings: cameras, controller, and a whole station."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np
import pytest

from vaoi_station.acquisition.cameras.interface import DeviceFault, Slot
from vaoi_station.acquisition.clocks import DeviceClock
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    BarrierClear,
    EventQueue,
    PulseFired,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.devices import Feedback
from vaoi_station.acquisition.process.messages import BoardMissed, FireOne, RunFinished, Trouble
from vaoi_station.acquisition.replay import (
    LEAD_S,
    RecordedRow,
    ReplayCamera,
    ReplayController,
    open_replay,
)
from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError
from vaoi_station.files import Recording, write_recording
from vaoi_station.model import CameraHead, RecordingHead, Verdict

TIMEOUT_S = 10.0


def test_frames_have_the_recorded_times_and_missing_ones_use_an_id() -> None:
    arrivals: SimpleQueue[Any] = SimpleQueue()
    camera = ReplayCamera(1, DeviceClock(5.0))
    slots = [Slot(n, np.zeros(8, np.uint8)) for n in range(3)]
    for slot in slots:
        camera.queue(slot)
    camera.start(arrivals)
    try:
        camera.play(10.0, np.full(8, 1, np.uint8))
        camera.play(10.1, None)
        camera.play(10.2, np.full(8, 3, np.uint8))
        found = [arrivals.get(timeout=TIMEOUT_S) for _ in range(2)]
        with pytest.raises(Empty):
            arrivals.get_nowait()
    finally:
        camera.close()
    assert [(a.camera, a.slot, a.frame_id, a.time_s) for a in found] == [(1, 0, 1, 10.0), (1, 1, 3, 10.2)]
    assert [slot.memory[0] for slot in slots] == [1, 3, 0]


PLAN = TriggerPlan(start_delay_s=0.1, period_s=0.02, tail_s=0.1, max_rows=5, debounce_s=0.005)
TIMES_S = (0.0, 0.020000001, 0.04)


class CountingPace(Feedback):
    """Lets everything pass, and counts frames."""

    def __init__(self) -> None:
        super().__init__()
        self.frames = 0
        self.woken = threading.Event()

    def wait_for_memory(self, stop: Callable[[], bool]) -> None: ...

    def wait_for_frames(self, stop: Callable[[], bool]) -> None: ...

    def expect_frames(self, frames: int) -> None:
        self.frames += frames

    def wake(self) -> None:
        self.woken.set()


class Bench:
    """A replay of runs and the device times at which rows were delivered."""

    def __init__(self, runs: int, pace: CountingPace | None, times_s: tuple[float, ...] = TIMES_S) -> None:
        self.delivered: list[float] = []
        rows = [RecordedRow(t, "top", (250.0,), self._deliver) for t in times_s]
        self.events: EventQueue = SimpleQueue()
        self.controller = ReplayController(iter([rows] * runs), DeviceClock(), 0.0, pace)
        self.controller.start(self.events)

    def _deliver(self, device_s: float) -> int:
        self.delivered.append(device_s)
        return 2

    def run(self) -> list[object]:
        events: list[object] = [self.events.get(timeout=10)]
        while not isinstance(events[-1], RunEnded):
            events.append(self.events.get(timeout=10))
        return events


@pytest.fixture
def make() -> Iterator[Callable[..., Bench]]:
    benches: list[Bench] = []

    def begin(runs: int = 1, pace: CountingPace | None = None, times_s: tuple[float, ...] = TIMES_S) -> Bench:
        benches.append(Bench(runs, pace, times_s))
        return benches[-1]

    yield begin
    for bench in benches:
        bench.controller.close()


@pytest.mark.parametrize("paced", [True, False])
def test_a_run_has_the_recorded_times(make: Callable[..., Bench], paced: bool) -> None:
    pace = CountingPace() if paced else None
    bench = make(pace=pace)
    bench.controller.arm(PLAN)
    events = bench.run()
    pulses = [e for e in events if isinstance(e, PulseFired)]
    assert [round(p.time_s - pulses[0].time_s, 9) for p in pulses] == list(TIMES_S)
    assert bench.delivered == [p.time_s for p in pulses]
    assert isinstance(events[0], BarrierBlocked)
    assert pulses[0].time_s - events[0].time_s == pytest.approx(LEAD_S, abs=1e-9)
    assert not any(isinstance(e, BarrierClear) for e in events), "a recording does not hold when its board left"
    assert isinstance(events[-1], RunEnded)
    assert (events[-1].pulses, events[-1].reason) == (3, "clear")
    assert pulses[1].exposures_us == (250.0,)
    assert pace is None or pace.frames == 6


def test_a_recording_that_cannot_be_read_is_reported() -> None:
    def runs() -> Iterator[list[RecordedRow]]:
        yield from map(damaged, [1])

    def damaged(_number: int) -> list[RecordedRow]:
        raise InputError("run.json: is damaged.", action="Replace it.")

    events: EventQueue = SimpleQueue()
    controller = ReplayController(runs(), DeviceClock(), 0.0, None)
    controller.start(events)
    fault = events.get(timeout=10)
    controller.close()
    assert isinstance(fault, DeviceFault)
    assert fault.error.message == "run.json: is damaged."


PERIOD_S = 0.04
ROW_TIMES_S = tuple(3.25 + k * PERIOD_S + 0.0012345678912 * (k % 2) for k in range(5))

Start = Callable[[StationConfig], Any]


@pytest.fixture
def recordings(tmp_path: Path) -> list[Recording]:
    """Two recordings of noise with uneven times; the second lacks two frames."""
    made = []
    for n, missing in enumerate(((), ((1, 2), (0, 4)))):
        head = RecordingHead(
            format="vaoi-recording",
            version=1,
            cameras=(CameraHead(width=48, height=32, exposure_us=250.0),) * 2,
            rows=5,
            trigger_period_s=PERIOD_S,
            conveyor_mm_s=(0.0, 100.0),
            missing=missing,
            trigger_times_s=ROW_TIMES_S,
            exposures_us=((250.0, 100.0),) * 5 if n else None,
            lights=("ring", "dome", "ring", "dome", "ring") if n else None,
        )
        pixels = np.random.default_rng(n).integers(0, 255, (2, 5, 32, 48), dtype=np.uint8)
        frames = [(c, r, pixels[c, r]) for c in range(2) for r in range(5) if (c, r) not in missing]
        made.append(write_recording(tmp_path / f"recording-{n}", head, frames))
    return made


@pytest.fixture
def make_replay(tmp_path: Path, recordings: list[Recording]) -> Callable[..., StationConfig]:
    def make(pace: str = "fast", camera: dict[str, object] | None = None, **line: object) -> StationConfig:
        (tmp_path / "shm").mkdir(exist_ok=True)
        size = {"width": 48, "height": 32, "exposure_us": 250.0, "backend": "replay", **(camera or {})}
        return StationConfig.model_validate(
            {
                "name": "replay",
                "calibration": tmp_path,
                "board_types": tmp_path,
                "data": tmp_path,
                "line": {
                    "conveyor_mm_s": (0.0, 100.0), "barrier_mm": 0.0, "start_delay_s": 0.1, "tail_s": 0.1,
                    "trigger_period_s": PERIOD_S, "longest_board_mm": 20.0, **line,
                },
                "cameras": [{"name": "a", **size}, {"name": "b", **size}],
                "controller": {"backend": "replay"},
                "replay": {"recordings": [r.directory for r in recordings], "pace": pace, "pause_s": 0.02},
                "ring": {"directory": tmp_path / "shm", "runs": 2},
            }
        )  # fmt: skip

    return make


def relative() -> tuple[float, ...]:
    return tuple(round(t - ROW_TIMES_S[0], 9) for t in ROW_TIMES_S)


@pytest.mark.parametrize("pace", ["fast", "original"])
def test_runs_come_back_exactly_as_recorded(
    start: Start, make_replay: Callable[..., StationConfig], recordings: list[Recording], pace: str
) -> None:
    bench = start(make_replay(pace))
    bench.arm(runs=2)
    for n in range(6):
        finished = bench.until(RunFinished)
        recording = recordings[1 if finished.head.lights else 0]  # one that waits for frames may be overtaken
        assert finished.head.trigger_times_s == relative()
        assert set(finished.head.missing) == set(recording.head.missing)
        assert finished.head.lights == recording.head.lights
        assert finished.head.exposures_us == recording.head.exposures_us
        assert finished.unassigned == 0
        assert finished.proof.proven, finished.proof.findings
        for frame in finished.frames:
            recorded = recording.frame(frame.camera, frame.row)
            if recorded is None:
                assert frame.verdict is Verdict.MISSING
                assert frame.cause
            else:
                assert np.array_equal(bench.ring.frame(frame.slot), recorded)
        bench.grant(f"run {n + 2}", finished.bay)
    if pace == "fast":
        assert bench.of(BoardMissed) == [], "a fast replay waits for memory"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"trigger_period_s": 0.05}, "trigger_period_s is 0.04"),
        ({"conveyor_mm_s": (0.0, 90.0)}, "conveyor_mm_s"),
        ({"longest_board_mm": 1.0}, "rows is 5"),
        ({"camera": {"width": 64}}, "48×32 px"),
        ({"camera": {"pixel_format": "Mono16"}}, "is 8 bit grey"),
    ],
)
def test_a_recording_of_another_station_is_refused(
    make_replay: Callable[..., StationConfig], changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        open_replay(make_replay(**changes))


def test_a_replay_refuses_single_pulses_and_continues(start: Start, make_replay: Callable[..., StationConfig]) -> None:
    bench = start(make_replay())
    bench.grant("one", 0)
    bench.send(FireOne())
    trouble = bench.until(Trouble)
    assert trouble.message == "a replay plays recorded boards; it cannot fire a pulse of its own."
    assert "Film the boards it plays" in trouble.action
    bench.arm()
    assert bench.until(RunFinished).run == "one"
