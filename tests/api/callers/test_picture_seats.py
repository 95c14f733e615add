"""The seats for pictures: a caller gets a limited number at a time, until it has read them."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from fastapi.routing import APIRoute

from vaoi_station.api.board_data import check_routes
from vaoi_station.api.callers.picture_seats import PICTURES_OF_CALLER
from vaoi_station.api.cameras import routes as cameras
from vaoi_station.api.cameras.trials import CameraTrials
from vaoi_station.api.event_hub import EventHub
from vaoi_station.api.parameters import PREFIX
from vaoi_station.api.routes import components, frames, merged, mosaics
from vaoi_station.api.routes.services import Services


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


def test_every_picture_of_a_camera_or_run_takes_a_seat(station: Any) -> None:
    """Its thread and its memory are limited until it is read; a route without a seat would have neither limit."""
    services = Services(station, EventHub(station))
    routers = [module.router(services) for module in (frames, components, merged, mosaics, check_routes)]
    routers.append(cameras.router(services, CameraTrials(services.coordinator)))
    routes = [route for router in routers for route in router.routes if isinstance(route, APIRoute)]
    of_pictures, unlimited = set(), set()
    for route in routes:
        media = {media for reply in route.responses.values() for media in reply.get("content", {})}
        # A pulse with settings on trial has a limit of its own: one at a time.
        if ("/cameras/" in route.path and "GET" in (route.methods or ())) or any(m.startswith("image/") for m in media):
            of_pictures.add(route.path)
            if not any(of.call == services.picture_seats.hold for of in route.dependant.dependencies):
                unlimited.add(route.path)
    assert {f"{PREFIX}/cameras/{{camera}}/frame", f"{PREFIX}/runs/{{run}}/mosaics/kept.jpg"} < of_pictures
    assert unlimited == set()
