"""The doctor runs in a process of its own, once for callers that ask together; a failure names what to do."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from vaoi_station.api.cameras import examination
from vaoi_station.api.cameras.examination import Examinations
from vaoi_station.errors import DeviceError, NotFoundError

FINDING = {"check": "disk", "subject": "", "level": "warning", "message": "nearly full", "action": "Make room."}
REPORT = {"created": "2026-01-01T00:00:00+00:00", "worst": "warning", "findings": [FINDING | {"figures": {}}]}


def answer(monkeypatch: pytest.MonkeyPatch, *replies: Any) -> list[list[str]]:
    """Let processes end with these outputs, or raise these errors; return the list of their commands."""
    commands: list[list[str]] = []

    def run(command: list[str], **_: Any) -> Any:
        reply = replies[len(commands)]
        commands.append(command)
        if isinstance(reply, Exception):
            raise reply
        return subprocess.CompletedProcess(command, 1, stdout=reply)

    monkeypatch.setattr(subprocess, "run", run)
    return commands


def test_one_examination_serves_all_who_ask_at_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    commands = answer(monkeypatch, json.dumps(REPORT), json.dumps(REPORT | {"worst": "ok"}))
    examinations = Examinations(Path("station.toml"))
    first = examinations.examine()
    assert (first.worst, first.findings[0].action) == ("warning", "Make room.")
    assert examinations.examine() == first
    assert len(commands) == 1
    assert commands[0][-4:] == ["doctor", "--json", "--config", "station.toml"]
    monkeypatch.setattr(examination, "KEPT_S", -1)
    assert examinations.examine().worst == "ok"


@pytest.mark.parametrize("reply", ["", "{}", "[1]", OSError("no nice"), subprocess.TimeoutExpired("vaoi", 60)])
def test_a_failure_names_the_command(monkeypatch: pytest.MonkeyPatch, reply: Any) -> None:
    answer(monkeypatch, reply)
    with pytest.raises(DeviceError, match="did not examine") as failure:
        Examinations(Path("station.toml")).examine()
    assert failure.value.code == "examination-failed"
    assert "vaoi doctor --config station.toml" in failure.value.action


def test_a_station_without_a_file_is_not_examined() -> None:
    with pytest.raises(NotFoundError, match=r"without a station\.toml"):
        Examinations(None).examine()
