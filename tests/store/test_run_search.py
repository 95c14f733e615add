"""The search in summaries: SQL and Python agree, pages have no gaps, and one request reads a bounded number."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from typing import Any

import pytest

from tests.store.conftest import MakeRun
from vaoi_station.store import Store, run_search
from vaoi_station.store.run_search import RunFilter

VERDICTS = (None, "ok", "degraded", "failed")
CODES: tuple[tuple[str, ...], ...] = ((), ("result", "rows-lost"), ("result", "lamp-dim"))


def summary_of(n: int) -> dict[str, Any]:
    codes = CODES[n % 3]
    return {
        "verdict": VERDICTS[n % 4],
        "board_type": "ab"[n % 2],
        "board_id": None if n % 5 == 0 else f"SN-{n % 5}",
        "reasons": [{"code": codes[0], "cause": codes[1]}] if codes else [],
        "started": f"2026-01-01T00:00:{n:02d}.000Z",
    }


@pytest.fixture
def filled(store: Store, make_run: MakeRun) -> Store:
    for n in range(24):
        run = replace(make_run(f"r{n:02d}", "ready", finish_number=n + 1), summary=json.dumps(summary_of(n)))
        store.save_run(run).result(10)
    return store


SIXTH = "2026-01-01T00:00:06.000Z"
CHOICES = ((None, "none", "ok"), (None, "b"), (None, "SN-3"), (None, "rows-lost", "result"), (None, SIXTH))
FILTERS = [RunFilter(*values) for values in itertools.product(*CHOICES)]
FILTERS += [RunFilter(until=SIXTH), RunFilter(board_id="' OR 1 --")]


def test_the_condition_in_sql_admits_what_the_filter_admits(filled: Store) -> None:
    summaries = {f"r{n:02d}": summary_of(n) for n in reversed(range(24))}
    for wanted in FILTERS:
        expected = [
            run
            for run, s in summaries.items()
            if wanted.admits(
                s["verdict"] or "none",
                s["board_type"],
                s["board_id"],
                [c for r in s["reasons"] for c in r.values()],
                s["started"],
            )
        ]
        assert list(filled.search.find(wanted, 99, None).runs) == expected, wanted


def test_pages_have_no_gaps_and_a_request_reads_a_bounded_number(
    filled: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_search, "MOST_SCANNED", 5)
    wanted, seen, before, requests = RunFilter(verdict="ok"), list[str](), None, 0
    while True:
        found = filled.search.find(wanted, 2, before)
        seen += found.runs
        requests += 1
        if (before := found.before) is None:
            break
    assert seen == [f"r{n:02d}" for n in range(21, -1, -4)]
    assert requests > 4


def test_runs_and_events_are_counted_from_a_time_on(filled: Store) -> None:
    since = "2026-01-01T00:00:16.000Z"
    assert filled.search.verdicts(since, "").runs == {"none": 2, "ok": 2, "degraded": 2, "failed": 2}
    assert filled.search.verdicts(since, "", ["r20", "r21"]).runs == {"none": 1, "ok": 1, "degraded": 2, "failed": 2}
    assert filled.search.oldest_since("r16") == "r15"
    assert filled.search.verdicts(since, "r15") == filled.search.verdicts(since, "")
    for n, (kind, second) in enumerate([("board-missed", 3), ("board-missed", 17), ("run", 18)]):
        event = {
            "number": n + 1,
            "kind": kind,
            "time": f"2026-01-01T00:00:{second:02d}.000Z",
            "message": "board-missed",
        }
        filled.add_event(n + 1, json.dumps(event)).result(10)
    assert filled.search.count_events("board-missed", since) == 1
