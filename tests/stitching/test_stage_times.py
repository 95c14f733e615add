"""Stages follow one another without a gap."""

from __future__ import annotations

import time

import pytest

from vaoi_station.stitching.conclude import StageTimes


def test_times_of_stages_add_up_to_the_whole() -> None:
    before = time.perf_counter()
    stages = StageTimes()
    for name in ("first", "second", "third"):
        sum(range(20_000))
        stages.finish(name)
    whole_ms = (time.perf_counter() - before) * 1e3
    assert list(stages.ms) == ["first", "second", "third"]
    assert all(ms > 0 for ms in stages.ms.values())
    assert sum(stages.ms.values()) == pytest.approx(whole_ms, rel=0.5, abs=5)
    assert sum(stages.ms.values()) <= whole_ms + 0.01
