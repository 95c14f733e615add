"""Tests of the choice of a backend, and of the check of its inputs."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from vaoi_station.acquisition.process.backends import check_backends, row_lights
from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError
from vaoi_station.files import write_recording
from vaoi_station.model import RecordingHead

Make = Callable[..., StationConfig]


@pytest.fixture
def make_replay(make_config: Make, tmp_path: Path) -> Callable[[int], StationConfig]:
    """Return a function that makes a station of two cameras that replays a recording of a number of cameras."""

    def make(cameras: int) -> StationConfig:
        config = make_config()
        head = RecordingHead(
            format="vaoi-recording",
            version=1,
            cameras=tuple(config.cameras[0].head for _ in range(cameras)),
            rows=1,
            trigger_period_s=config.line.trigger_period_s,
            conveyor_mm_s=config.line.conveyor_mm_s,
        )
        black = np.zeros((config.cameras[0].height, config.cameras[0].width), np.uint8)
        write_recording(tmp_path / "recording", head, [(n, 0, black) for n in range(cameras)])
        return make_config(
            simulation=None,
            cameras=[{**c.model_dump(), "backend": "replay"} for c in config.cameras],
            controller={"backend": "replay"},
            replay={"recordings": [tmp_path / "recording"], "pace": "fast"},
        )

    return make


def test_a_scenario_that_fits_is_accepted_and_another_refused(make_config: Make, tmp_path: Path, tiny: str) -> None:
    config = make_config()
    check_backends(config)
    (tmp_path / "scenario.toml").write_text(tiny.replace("cameras = 2", "cameras = 3"))
    with pytest.raises(InputError, match=r"array\.cameras is 3, but must be 2"):
        check_backends(config)


def test_the_lights_of_rows_are_those_of_controller_recordings_or_scenario(
    make_config: Make, make_replay: Callable[[int], StationConfig], tmp_path: Path
) -> None:
    assert row_lights(make_config()) == ("ring",)
    assert row_lights(make_replay(2)) == ()
    lit = json.loads((tmp_path / "recording" / "recording.json").read_text())
    replay = make_replay(2)
    (tmp_path / "recording" / "recording.json").write_text(json.dumps(lit | {"lights": ["left"]}))
    assert row_lights(replay) == ("left",)
    (tmp_path / "recording" / "recording.json").unlink()
    assert row_lights(replay) == ()
    lamp = {"channels": [1], "on_us": 100.0}
    serial = make_config(
        simulation=None,
        cameras=[{**c.model_dump(), "backend": "aravis", "serial": c.name} for c in make_config().cameras],
        controller={"backend": "serial", "lights": {"left": lamp, "right": lamp}, "order": ["right", "left"]},
    )
    assert row_lights(serial) == ("right", "left")
