"""Pictures of known blur, crosses at known places, and a station that replays a calibration board."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.config import StationConfig
from vaoi_station.demo.station_files import to_toml
from vaoi_station.files import write_recording
from vaoi_station.files.layouts import Layout, write_layout
from vaoi_station.marks.mark_shape import Shape, coverage
from vaoi_station.model import RecordingHead

FINE = 4
"""Factor by which pictures are drawn finer and then reduced: the pixel width is part of the blur."""
CENTRES = ((60.0, 50.0), (260.0, 50.5), (60.25, 190.0), (260.0, 190.75))


class Painter:
    """Draws frames."""

    def tilted_board(self, blur_px: float, noise: float = 0.0, size: tuple[int, int] = (480, 360)) -> NDArray[np.uint8]:
        """A checker board, turned a little, with a blur of known standard deviation, the pixel's width included."""
        w, h = (side * FINE for side in size)
        y, x = np.mgrid[:h, :w].astype(np.float32) / FINE
        u, v = (x * np.cos(0.2) + y * np.sin(0.2)) / 37, (y * np.cos(0.2) - x * np.sin(0.2)) / 37
        levels = np.where((np.floor(u) + np.floor(v)) % 2 > 0, 200.0, 50.0).astype(np.float32)
        lens = float(np.sqrt(max(blur_px**2 - 1 / 12, 1e-4)) * FINE)
        blurred = cv2.GaussianBlur(levels, (0, 0), lens)
        return self.exposed(cv2.resize(blurred, size, interpolation=cv2.INTER_AREA), noise)

    def marks(self, shape: Shape = "cross", size_px: float = 24.0, *, light: bool = False) -> NDArray[np.uint8]:
        """Four marks at CENTRES on an even ground."""
        cover = np.zeros((240, 320))
        for x, y in CENTRES:
            cover += coverage(shape, size_px, 320, (x, y))[:240]
        ground, mark = (60, 190) if light else (190, 60)
        return self.exposed(cv2.GaussianBlur(ground + (mark - ground) * cover, (0, 0), 0.7), 1.0)

    @staticmethod
    def exposed(levels: NDArray[Any], noise: float) -> NDArray[np.uint8]:
        random = np.random.default_rng(7)
        return np.asarray(np.clip(np.rint(levels + random.normal(0, noise, levels.shape)), 0, 255), np.uint8)


@pytest.fixture(scope="session")
def painter() -> Any:
    return Painter()


@pytest.fixture(scope="session")
def centres() -> tuple[tuple[float, float], ...]:
    return CENTRES


@pytest.fixture
def layout(tmp_path: Path) -> Path:
    """What `Painter.marks` shows, at 10 px per mm."""
    places = [{"x": (x - 159.5) / 10, "y": (y - 119.5) / 10} for x, y in CENTRES]
    content = {"mark": {"size": 2.4, "width": 0.6, "polarity": "dark"}, "marks": places}
    write_layout(tmp_path / "layout.json", Layout.model_validate(content))
    return tmp_path / "layout.json"


@pytest.fixture
def make_config(tmp_path: Path, painter: Painter) -> Callable[..., StationConfig]:
    """A station of two cameras that replays a run of three rows; there is no calibration yet."""

    def make(**camera: Any) -> StationConfig:
        heads = [{"width": 320, "height": 240, "exposure_us": 100.0}] * 2
        head = RecordingHead.model_validate(
            {
                "format": "vaoi-recording", "version": 1, "cameras": heads, "rows": 3, "trigger_period_s": 0.05,
                "conveyor_mm_s": [0.0, 100.0], "missing": [[1, 2]],
            }
        )  # fmt: skip
        crosses, discs = painter.marks(), painter.marks("circle")
        frames = [(i, j, crosses if i == 0 else discs) for i in range(2) for j in range(3) if (i, j) != (1, 2)]
        write_recording(tmp_path / "recording", head, frames)
        (tmp_path / "shm").mkdir(exist_ok=True)
        cameras = [{"name": f"c{i}", "backend": "replay", **heads[i], **camera} for i in range(2)]
        return StationConfig.model_validate(
            {
                "name": "view", "calibration": tmp_path / "none.json", "board_types": tmp_path / "types",
                "data": tmp_path / "data", "cameras": cameras, "controller": {"backend": "replay"},
                "line": {
                    "conveyor_mm_s": (0.0, 100.0), "barrier_mm": 0.0, "start_delay_s": 0.0,
                    "trigger_period_s": 0.05, "tail_s": 0.0, "longest_board_mm": 50.0,
                },
                "replay": {"recordings": (tmp_path / "recording",), "pause_s": 0.05},
                "ring": {"directory": tmp_path / "shm"},
            }
        )  # fmt: skip

    return make


@contextmanager
def _viewing(config: StationConfig, folder: Path, *options: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """`vaoi view` as a process with its address; ended by SIGTERM."""
    (folder / "station.toml").write_text(to_toml(config))
    command = [sys.executable, "-m", "vaoi_station", "view", "--config", str(folder / "station.toml"), "--port", "0"]
    process = subprocess.Popen(
        [*command, *options], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env={**os.environ}
    )
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        assert line.startswith("Live frames: http://127.0.0.1:"), line + process.stdout.read()
        yield line.split()[-1], process
    finally:
        process.send_signal(signal.SIGTERM)
        said = process.communicate(timeout=60)[0]
    assert process.returncode == 0, said
    assert "Traceback" not in said


@pytest.fixture
def viewing() -> Callable[..., AbstractContextManager[tuple[str, subprocess.Popen[str]]]]:
    """`viewing(config, folder, *options)`: the program while a `with` lasts."""
    return _viewing
