"""Which runs are forgotten, in which order, and that pinned ones are not."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.store.conftest import NOW, MakeRun
from vaoi_station.errors import StateError
from vaoi_station.store import Store, retention
from vaoi_station.store.retention import RunRetention


@pytest.fixture
def kept(store: Store, monkeypatch: pytest.MonkeyPatch) -> RunRetention:
    monkeypatch.setattr(retention, "NEVER_FORGOTTEN", 1)
    return store.retention


def fill(store: Store, make_run: MakeRun, runs: int, doubtful: frozenset[int] = frozenset()) -> None:
    """Store runs r00, r01, … with results; those in `doubtful` are degraded, the others ok."""
    for n in range(runs):
        summary = f'{{"verdict": "{"degraded" if n in doubtful else "ok"}"}}'
        begun = replace(make_run(f"r{n:02d}", "filming"), summary=summary)
        store.save_run(begun).result(10)
        ended = replace(begun, state="ready", finish_number=n + 1)
        store.save_run(ended, '{"t": 1}', '{"m": 1}').result(10)


def test_the_oldest_runs_beyond_number_or_age_are_selected_by_verdict(
    store: Store, kept: RunRetention, make_run: MakeRun
) -> None:
    fill(store, make_run, 10, doubtful=frozenset({0, 5}))
    assert kept.whole() == (8, 2)
    assert kept.surplus(False, 6, "", 10) == ["r01", "r02"]
    assert kept.surplus(False, 100, "r04", 10) == ["r01", "r02", "r03"]
    assert kept.surplus(False, 100, "~", 3) == ["r01", "r02", "r03"]
    assert kept.surplus(True, 1, "", 10) == ["r00"]
    assert kept.surplus(True, 100, "~", 10) == ["r00"], "the newest run of a kind always stays"
    assert kept.surplus(True, 100, "", 10) == []


def test_of_a_forgotten_run_the_summary_stays_until_it_is_forgotten_too(
    store: Store, kept: RunRetention, make_run: MakeRun
) -> None:
    fill(store, make_run, 3)
    kept.forget_details(["r00", "r01"]).result(10)
    row = store.run("r00")
    assert row is not None
    assert (row.summary, row.detail, row.head) == ('{"verdict": "ok"}', "", None)
    assert store.result("r00") is store.timeline("r00") is None
    assert store.result("r02") == '{"m": 1}'
    following = store.finished_after(0)
    assert following is not None
    assert following.id == "r02", "callers go on with the oldest run that is whole"
    assert kept.old_summaries(1000, "r02", 10) == ["r00", "r01"]
    assert kept.old_summaries(2, "", 10) == ["r00"]
    assert not kept.forgotten("r00")
    kept.forget_runs(["r00"]).result(10)
    assert store.run("r00") is None
    assert kept.forgotten("r00")
    assert not kept.forgotten("r01")
    kept.forget_runs([]).result(10)
    assert [row.id for row in store.runs(9, None)] == ["r02", "r01"]


def test_pinned_runs_are_never_forgotten(
    store: Store, kept: RunRetention, make_run: MakeRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    fill(store, make_run, 4)
    kept.pin("r00", NOW)
    kept.pin("r00", NOW)
    assert kept.pinned("r00")
    assert not kept.pinned("r01")
    assert kept.surplus(False, 1, "~", 10) == ["r01", "r02"]
    kept.forget_details(["r00", "r01"]).result(10)
    assert store.result("r00") is not None, "it was pinned after it had been selected"
    monkeypatch.setattr(retention, "MOST_PINS", 1)
    with pytest.raises(StateError, match="1 runs are pinned, which is the limit"):
        kept.pin("r02", NOW)
    kept.unpin("r00")
    kept.unpin("r00")
    assert kept.pins() == frozenset()
