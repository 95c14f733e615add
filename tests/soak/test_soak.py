"""The soak in short: a real station, a few faults, every run accounted for; and the arithmetic of its slopes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.needs import LONG
from tests.soak.accounts import account
from tests.soak.faults import FAULTS
from tests.soak.slopes import slope_of
from tests.soak.soaking import Plan, Record, Soak
from tests.soak.year import Extent, make_history
from tests.transfer.conftest import Site, _silent_peer, make_rig, site, store
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.store import Database, Store

__all__ = ["_silent_peer", "make_rig", "site", "store"]

SHORT = ("worker killed", "many event streams", "half-sent requests", "disk full")


@pytest.fixture(scope="module")
def soaked(tmp_path_factory: pytest.TempPathFactory) -> Record:
    """What a short soak has measured. Boards come slowly enough for a busy machine."""
    plan = (
        Plan(2000, 0.2, tuple(FAULTS), lost_share=0.02)
        if LONG
        else Plan(20, 0.4, SHORT, every=1.0, duration=0.1, lost_share=0.1)
    )
    soak = Soak(tmp_path_factory.mktemp("soak"), plan)
    record = soak.run()
    assert record.exit_code == 0, soak.log()
    assert "incident" not in soak.log()
    return record


def test_every_run_of_a_soak_is_accounted_for(soaked: Record) -> None:
    assert soaked.accounts is not None
    assert soaked.accounts.finds == ()
    assert soaked.accounts.announced >= 20
    assert soaked.injected
    assert soaked.ends is not None
    assert soaked.ends.own == []


@pytest.mark.parametrize(("growth", "flat"), [(0.0, True), (0.02, False), (-0.02, False)])
def test_a_slope_is_found_and_noise_is_none(growth: float, flat: bool) -> None:
    g = np.random.default_rng(3)
    x = np.arange(1500.0)
    slope = slope_of([(x, 200 + growth * x + g.normal(0, 3, len(x)))])
    assert slope is not None
    assert slope.flat is flat
    assert slope.low <= growth <= slope.high


def test_a_leak_is_found_although_every_life_begins_anew() -> None:
    g = np.random.default_rng(5)
    lives = [(np.arange(k, k + 150.0), 100 + 0.1 * np.arange(150) + g.normal(0, 1, 150)) for k in range(0, 900, 150)]
    slope = slope_of(lives)
    assert slope is not None
    assert slope.low > 0
    assert slope.per_board == pytest.approx(0.1, rel=0.2)


def shown(**changed: Any) -> dict[str, Any]:
    run = {"state": "gone", "verdict": "ok", "finished": "2026-01-01T00:00:00Z", "reasons": [], "stored": True}
    return run | changed


@pytest.mark.parametrize(
    ("announced", "listed", "find"),
    [
        ({"b": "ok", "c": "ok"}, {"b": shown()}, "c: announced as 'ok', not listed"),
        ({}, {"b": shown()}, "never announced"),
        ({"b": "failed"}, {"b": shown()}, "announced as 'failed', listed as 'ok'"),
        ({"b": "ok"}, {"b": shown(state="stitching", finished=None)}, "has not ended"),
        ({"b": ""}, {"b": shown(verdict=None)}, "without a reason"),
        ({"b": "ok"}, {"b": shown(stored=False)}, "is not on disk"),
    ],
)
def test_contradictions_are_found(announced: dict[str, str], listed: dict[str, Any], find: str) -> None:
    found = account(announced, listed, []).finds
    assert any(find in f for f in found), found


def test_one_run_is_multiplied_into_a_history(site: Site) -> None:
    site.rig.store.close()
    database = site.rig.config.data / "station.db"
    extent = Extent(runs=400, whole=30, doubtful=20, result_kb=3.0, events=50)
    now_s = 1.8e9
    make_history(database, extent, now_s)
    store = Store(Database(database))
    archive = Archive(store, EventLog(store))
    assert store.retention.whole() == (29, 20), "the newest runs are ok, but for one in twenty"
    latest = archive.latest()
    assert latest is not None
    assert (latest.finish_number, latest.detail.id) == (400, archive.list(1, None)[0].id)
    assert store.last_event() == 50
    (size,) = store.database.read("SELECT avg(length(packed)) FROM results")[0]
    assert 2800 < size < 3600
    assert store.retention.surplus(False, 29, "", 10) == []
    store.close()
