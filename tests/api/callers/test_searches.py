"""Searches and long lists have threads of their own, so that others do not wait for them."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from vaoi_station.api.callers.searches import SEARCHES_OF_CALLER
from vaoi_station.api.event_hub import COMMAND_THREADS

PATIENCE_S = 20.0


@pytest.mark.parametrize("what", ["runs?reason=glare", "runs?read_id=b", "runs/counts", "components"])
def test_commands_and_matrices_do_not_wait_for_searches(
    served: Any, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    station, release, begun = served.station, threading.Event(), threading.Semaphore(0)
    run = station.film()

    def held_up(call: Any) -> Any:
        def wait(*arguments: Any) -> Any:
            begun.release()
            release.wait(PATIENCE_S)
            return call(*arguments)

        return wait

    monkeypatch.setattr(station, "components", held_up(station.components))
    monkeypatch.setattr(station.kept, "with_id", held_up(station.kept.with_id))
    for name in ("find", "counts"):
        monkeypatch.setattr(station.kept.history, name, held_up(getattr(station.kept.history, name)))
    address = f"/api/v1/{what}" if what != "components" else f"/api/v1/runs/{run}/components"
    with ThreadPoolExecutor(COMMAND_THREADS + 4) as pool:
        try:
            searches = [pool.submit(served.client.get, address) for _ in range(COMMAND_THREADS + 4)]
            for _ in range(SEARCHES_OF_CALLER):
                assert begun.acquire(timeout=PATIENCE_S)
            assert served.client.get(f"/api/v1/runs/{run}/matrices").status_code == 200
            assert served.client.post("/api/v1/station/disarm").status_code == 200
            assert not any(search.done() for search in searches)
        finally:
            release.set()
        assert {search.result(PATIENCE_S).status_code for search in searches} == {200}
