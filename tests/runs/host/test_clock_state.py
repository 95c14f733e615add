"""The state of the clock agrees with what the machine's own programs report."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from vaoi_station.runs.host import clock_state as module
from vaoi_station.runs.host.clock_state import clock_state


def test_the_offset_is_that_of_the_present_time_zone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the present one also if it was set while the program ran, as `timedatectl set-timezone` does."""
    monkeypatch.setenv("TZ", "Asia/Kolkata")
    try:
        state = clock_state()
    finally:
        monkeypatch.undo()
        time.tzset()
    assert (state.time_zone, state.utc_offset_s) == ("Asia/Kolkata", 19_800)


def test_the_name_comes_from_the_link_of_the_machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("TZ", raising=False)
    zone = tmp_path / "zoneinfo" / "Europe" / "Berlin"
    zone.parent.mkdir(parents=True)
    zone.write_bytes(b"")
    monkeypatch.setattr(module, "LOCAL_TIME", tmp_path / "localtime")
    (tmp_path / "localtime").symlink_to(zone)
    assert clock_state().time_zone == "Europe/Berlin"
    (tmp_path / "localtime").unlink()
    assert clock_state().time_zone == time.localtime().tm_zone


def test_a_clock_that_no_program_keeps_right_has_no_error_bound() -> None:
    state = clock_state()
    assert state.synchronised in (True, False, None)
    assert (state.max_error_s is not None) == bool(state.synchronised)
