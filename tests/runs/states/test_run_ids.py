"""Run ids and times."""

from __future__ import annotations

import re
import time
from datetime import datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.runs.states.run_ids import (
    RunIds,
    last_midnight,
)


# Summer time begins and ends at two o'clock or at three in Berlin, and at midnight in Santiago: on 6 September 2026 the
# clock went from 0:00 to 1:00 there, so that the day began at one o'clock.
@pytest.mark.parametrize(
    ("zone", "now", "midnight"),
    [
        ("Europe/Berlin", "2026-03-29T12:00", "2026-03-28T23:00"),
        ("Europe/Berlin", "2026-03-29T01:00", "2026-03-28T23:00"),
        ("Europe/Berlin", "2026-10-25T12:00", "2026-10-24T22:00"),
        ("Europe/Berlin", "2026-10-25T00:00", "2026-10-24T22:00"),
        ("Europe/Berlin", "2026-12-31T23:59", "2026-12-30T23:00"),
        ("America/Santiago", "2026-09-06T12:00", "2026-09-06T04:00"),
        ("America/St_Johns", "2028-02-29T12:00", "2028-02-29T03:30"),
        ("Pacific/Kiritimati", "2026-01-01T00:00", "2025-12-31T10:00"),
    ],
)
def test_a_day_begins_at_its_midnight_also_if_the_clock_was_changed_since(
    monkeypatch: pytest.MonkeyPatch, zone: str, now: str, midnight: str
) -> None:
    monkeypatch.setenv("TZ", zone)
    try:
        found = last_midnight(datetime.fromisoformat(now))
    finally:
        monkeypatch.undo()
        time.tzset()
    assert found == datetime.fromisoformat(f"{midnight}Z")


@given(st.lists(st.integers(0, 2**44), min_size=2, max_size=30))
def test_ids_rise_whatever_the_clock_does(clock_ms: list[int]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        ids, given_out = RunIds(), []
        for ms in clock_ms:
            patch.setattr(time, "time_ns", lambda ms=ms: ms * 1_000_000)
            given_out.append(ids.next())
    assert given_out == sorted(set(given_out))
    assert all(re.fullmatch(r"[0-9a-hjkmnp-tv-z]{10}-[0-9a-hjkmnp-tv-z]{6}", name) for name in given_out)
