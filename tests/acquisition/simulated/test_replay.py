"""Tests of the replay end to end: runs equal their recordings, to the nanosecond."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.acquisition.process.messages import BoardMissed, FireOne, PulseReported, RunFinished, Trouble
from vaoi_station.acquisition.replay import open_replay
from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError
from vaoi_station.files import Recording, write_recording
from vaoi_station.model import CameraHead, RecordingHead, Verdict

PERIOD_S = 0.04
TIMES_S = tuple(3.25 + k * PERIOD_S + 0.0012345678912 * (k % 2) for k in range(5))

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
            trigger_times_s=TIMES_S,
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
    return tuple(round(t - TIMES_S[0], 9) for t in TIMES_S)


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


def test_a_fast_replay_waits_for_memory_and_can_be_disarmed_meanwhile(
    start: Start, make_replay: Callable[..., StationConfig]
) -> None:
    bench = start(make_replay())
    bench.arm()
    assert bench.disarm().unused == ()
    bench.arm()
    bench.grant("late", 0)
    assert bench.until(RunFinished).run == "late"


def test_disarming_in_the_middle_cuts_the_recording_short(
    start: Start, make_replay: Callable[..., StationConfig], recordings: list[Recording]
) -> None:
    path = recordings[0].directory / "recording.json"
    head = json.loads(path.read_text())
    head["trigger_times_s"] = [0.0, 0.04, 0.08, 20.0, 20.04]
    path.write_text(json.dumps(head))
    bench = start(make_replay("original"))
    bench.grant("cut", 0)
    bench.arm()
    bench.until(PulseReported)
    bench.disarm()
    (finished,) = bench.of(RunFinished)
    assert finished.reason == "disarmed"
    assert 1 <= finished.head.rows <= 3
    assert finished.head.trigger_times_s == (0.0, 0.04, 0.08)[: finished.head.rows]


def test_a_plan_with_too_few_rows_is_reported(start: Start, make_replay: Callable[..., StationConfig]) -> None:
    config = make_replay(longest_board_mm=10.0)
    assert config.line.rows_of_longest_board < 5 <= config.rows_per_run
    bench = start(config)
    bench.grant("one", 0)
    bench.arm()
    trouble = bench.until(Trouble)
    assert "max_rows" in trouble.message
    assert "5 rows of the recording" in trouble.message


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
