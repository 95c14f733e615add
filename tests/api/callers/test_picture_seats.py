"""The seats for pictures: a caller gets a limited number at a time, until it has read them."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from vaoi_station.api.callers.picture_seats import PICTURES_OF_CALLER


def test_one_caller_has_a_limited_number_of_pictures_made_at_a_time(
    served: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, frame = served.station.film(), served.station.frame
    lock, full, now, most = threading.Lock(), threading.Event(), 0, 0

    def counted(*arguments: Any) -> Any:
        nonlocal now, most
        with lock:
            now += 1
            most = max(most, now)
            if now == PICTURES_OF_CALLER:
                full.set()
        full.wait(20)
        try:
            return frame(*arguments)
        finally:
            with lock:
                now -= 1

    monkeypatch.setattr(served.station, "frame", counted)
    with ThreadPoolExecutor(20) as pool:
        wanted = [pool.submit(served.client.get, f"/api/v1/runs/{run}/frames/0/0") for _ in range(20)]
        assert {w.result(30).status_code for w in wanted} == {200}
    assert most == PICTURES_OF_CALLER
