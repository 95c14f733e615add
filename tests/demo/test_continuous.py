"""Describe boards, and choose the port."""

from __future__ import annotations

import socket

import pytest

from vaoi_station.config import ApiConfig
from vaoi_station.demo import continuous
from vaoi_station.demo.continuous import default_port, describe_run


def test_run_is_described_in_one_line() -> None:
    run = {
        "verdict": "ok", "rows": 6, "cameras": 2, "counts": {"ok": 12}, "reasons": [],
        "belt": {"ratio": 1.00704}, "timings": {"ready_after_last_frame_ms": 61.05},
    }  # fmt: skip
    assert describe_run(3, run) == "board 3: ok, 12 of 12 frames, belt +0.70 %, matrices 61 ms after the last frame"
    failed = run | {"verdict": "failed", "belt": None, "timings": {}, "reasons": [{"message": "It lies turned round."}]}
    assert describe_run(4, failed) == "board 4: failed, 12 of 12 frames, It lies turned round."


def test_default_port_is_used_unless_a_program_listens_there(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        taken = ApiConfig(port=other.getsockname()[1])
        monkeypatch.setattr(continuous, "ApiConfig", lambda: taken)
        assert default_port() == 0
    assert default_port() == taken.port
