"""Describe boards, and refuse a port that is in use."""

from __future__ import annotations

import socket

import pytest

from vaoi_station.config import ApiConfig
from vaoi_station.demo import continuous
from vaoi_station.demo.continuous import describe_run, run_continuously
from vaoi_station.errors import DeviceError
from vaoi_station.simulation import scenario_path


def test_run_is_described_in_one_line() -> None:
    run = {
        "verdict": "ok", "rows": 6, "cameras": 2, "counts": {"ok": 12}, "reasons": [],
        "belt": {"ratio": 1.00704}, "timings": {"ready_after_last_frame_ms": 61.05},
    }  # fmt: skip
    assert describe_run(3, run) == "board 3: ok, 12 of 12 frames, belt +0.70 %, matrices 61 ms after the last frame"
    failed = run | {"verdict": "failed", "belt": None, "timings": {}, "reasons": [{"message": "It lies turned round."}]}
    assert describe_run(4, failed) == "board 4: failed, 12 of 12 frames, It lies turned round."


def test_a_port_in_use_is_refused_before_the_board_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """A random port in its place would leave callers of the documented port with another station."""
    said: list[str] = []
    with socket.create_server(("127.0.0.1", 0)) as other:
        taken = other.getsockname()[1]
        monkeypatch.setattr(continuous, "ApiConfig", lambda: ApiConfig(port=taken))
        for port in (None, taken):
            with pytest.raises(DeviceError, match=f"port {taken} .*--port 0"):
                run_continuously(scenario_path("small"), port, said.append)
    assert said == []
