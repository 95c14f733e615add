"""Counts and waiting times of runs."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from vaoi_station.model import Status
from vaoi_station.runs.archive.run_statistics import LATENCY_BOUNDS_S, RunStatistics
from vaoi_station.runs.states.schemas import VerdictCounts


def run(verdict: Status | None, waited_s: float | None) -> tuple[Any, Any]:
    detail = SimpleNamespace(verdict=verdict, counts=VerdictCounts(ok=10, incomplete=1, missing=0))
    return detail, SimpleNamespace(last_frame_s=2.0, ready_s=None if waited_s is None else 2.0 + waited_s)


def test_runs_are_counted_by_verdict_and_waiting_time() -> None:
    statistics = RunStatistics()
    for verdict, waited_s in ((Status.OK, 0.2), (Status.OK, 1e9), (Status.DEGRADED, 0.05), (None, None)):
        statistics.add(*run(verdict, waited_s))
    figures = statistics.figures()
    assert figures.verdicts == {"ok": 2, "degraded": 1, "none": 1}
    assert figures.frames == {"ok": 40, "incomplete": 4, "missing": 0, "unproven": 0}
    assert len(figures.latencies) == len(LATENCY_BOUNDS_S) + 1
    assert (figures.latencies[2], figures.latencies[-1], sum(figures.latencies)) == (1, 1, 3)
    assert figures.latency_sum_s > 1e9


def test_a_result_before_the_last_frame_has_not_waited() -> None:
    statistics = RunStatistics()
    statistics.add(*run(Status.OK, -0.1))
    assert statistics.figures().latency_sum_s == 0
