"""vaoi doctor for callers of REST."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from vaoi_station.api.routes import doctor
from vaoi_station.api.routes.doctor import DOCTOR, Examinations
from vaoi_station.errors import DeviceError

FINDING = {"check": "disk", "subject": "", "level": "warning", "message": "nearly full", "action": "Make room."}
REPORT = {"created": "2026-01-01T00:00:00+00:00", "worst": "warning", "findings": [FINDING | {"figures": {}}]}
HANGS = "import signal; signal.pause()"


class Line:
    """Examinations whose doctor is a given program, which notes each of its starts."""

    def __init__(self, folder: Path, program: str) -> None:
        self._starts, self._stopping = folder / "starts", asyncio.Event()
        note = f"import os, sys; open({str(self._starts)!r}, 'a').write(f'{{os.getpid()}} {{sys.argv[1]}}\\n')"
        doctor = (sys.executable, "-c", f"{note}\n{program}")
        self.examinations = Examinations(folder / "station.toml", self._stop_requested, doctor)

    def stop(self) -> None:
        self._stopping.set()

    async def _stop_requested(self) -> None:
        await self._stopping.wait()

    def starts(self) -> list[list[str]]:
        return [line.split() for line in self._starts.read_text().splitlines()] if self._starts.exists() else []

    async def started(self, examining: asyncio.Future[Any]) -> None:
        """Wait until the doctor runs, or its examination has ended."""
        while not self.starts() and not examining.done():
            await asyncio.sleep(0.01)


def reporting(path: Path) -> str:
    return f"print(open({str(path)!r}).read())"


def test_one_examination_serves_all_who_ask_at_the_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    report = tmp_path / "report.json"
    report.write_text(json.dumps(REPORT))

    async def run() -> None:
        line = Line(tmp_path, reporting(report))
        first, second = await asyncio.gather(line.examinations.examine(), line.examinations.examine())
        assert (first.worst, first.findings[0].action) == ("warning", "Make room.")
        assert await line.examinations.examine() == second == first
        assert [start[1] for start in line.starts()] == [str(tmp_path / "station.toml")]
        monkeypatch.setattr(doctor, "KEPT_S", -1)
        report.write_text(json.dumps(REPORT | {"worst": "ok"}))
        assert (await line.examinations.examine()).worst == "ok"

    asyncio.run(run())
    assert DOCTOR[-3:] == ("doctor", "--json", "--config")


@pytest.mark.parametrize("program", ["", "print('{}')", "print([1])"])
def test_a_failure_names_the_command_and_is_kept(tmp_path: Path, program: str) -> None:
    async def run() -> None:
        line = Line(tmp_path, program)
        for _ in range(2):
            with pytest.raises(DeviceError, match="did not examine") as failure:
                await line.examinations.examine()
            assert failure.value.code == "examination-failed"
            assert f"vaoi doctor --config {tmp_path / 'station.toml'}" in failure.value.action
        assert len(line.starts()) == 1

    asyncio.run(run())


@pytest.mark.parametrize(
    ("limit_s", "end", "why"),
    [(60.0, Line.stop, "the station is stopping"), (0.5, lambda _: None, r"it took longer than 0\.5 s")],
)
def test_a_doctor_that_hangs_ends_with_the_station_or_at_its_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit_s: float, end: Callable[[Line], Any], why: str
) -> None:
    async def run() -> None:
        line = Line(tmp_path, HANGS)
        examining = asyncio.create_task(line.examinations.examine())
        await line.started(examining)
        end(line)
        with pytest.raises(DeviceError, match=why):
            await asyncio.wait_for(examining, 30)
        assert not any(Path("/proc", start[0]).exists() for start in line.starts())

    monkeypatch.setattr(doctor, "LIMIT_S", limit_s)
    asyncio.run(run())
