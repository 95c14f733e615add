"""The latest frame of each camera is kept, inspected once, and can be fetched while it is shown."""

from __future__ import annotations

import threading
from typing import Any

import cv2
import numpy as np
import pytest

from vaoi_station.errors import GoneError
from vaoi_station.viewing import latest_frames as module
from vaoi_station.viewing.latest_frames import LatestFrames


def frame(level: int) -> Any:
    return np.full((24, 32), level, np.uint8)


def test_listed_frames_can_be_fetched_for_a_while() -> None:
    latest = LatestFrames([None, None])
    assert latest.frames() == []
    for k in range(3):
        latest.put(0, "1", k, frame(k))
    assert [(s.camera, s.row, s.number) for s in latest.frames()] == [(0, 2, 3)]
    latest.put(1, "1", 0, frame(9))
    assert [s.number for s in latest.frames()] == [3, 4]
    with pytest.raises(GoneError, match="frame 2 of camera 0 is no longer kept"):
        latest.frame(0, 2)
    for k in range(10):
        latest.put(0, "2", k, frame(k))
        latest.frames()
    with pytest.raises(GoneError):
        latest.frame(0, 3)
    assert latest.frame(0, 12).row == 7
    with pytest.raises(GoneError):
        latest.frame(7, 1)


def test_a_frame_is_inspected_once(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []

    def look(pixels: Any, _: Any) -> str:
        calls.append(int(pixels[0, 0]))
        return "looked"

    monkeypatch.setattr(module, "inspect_frame", look)
    latest = LatestFrames([None])
    latest.put(0, "1", 0, frame(5))
    listed = latest.frames()[0]
    threads = [threading.Thread(target=lambda: listed.inspection) for _ in range(8)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert calls == [5]


def test_a_waiting_request_is_woken_by_the_next_frame() -> None:
    latest = LatestFrames([None])
    latest.put(0, "1", 0, frame(1))
    assert latest.wait(0, 0) == 1
    assert latest.wait(1, 0) == 1, "the time is over"
    got: list[int] = []
    waiting = threading.Thread(target=lambda: got.append(latest.wait(1, 30)))
    waiting.start()
    latest.put(0, "1", 1, frame(2))
    waiting.join()
    assert got == [2]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_pictures_use_the_full_scale(dtype: type) -> None:
    latest = LatestFrames([None])
    pixels: Any = np.full((24, 32), 65535 if dtype is np.uint16 else 255, dtype)
    latest.put(0, "1", 0, pixels)
    jpeg = latest.frames()[0].jpeg()
    assert np.asarray(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_UNCHANGED)).min() > 250
