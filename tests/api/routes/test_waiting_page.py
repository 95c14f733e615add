"""The replies of a service whose station cannot be started yet."""

from __future__ import annotations

import httpx2
import pytest

from vaoi_station.api.routes.waiting_page import WaitingPage
from vaoi_station.api.web_server import open_listener
from vaoi_station.errors import BusyError, DeviceError


def test_every_request_is_answered_with_the_present_cause() -> None:
    with open_listener("127.0.0.1", 0, "test") as listener:
        address = f"http://127.0.0.1:{listener.getsockname()[1]}"
        with WaitingPage(listener, ["127.0.0.1"]) as page, httpx2.Client(base_url=address) as client:
            page.report(DeviceError("The disk is full.", action="Free space.", code="storage-full"))
            for method, path in (("GET", "/healthz"), ("GET", "/api/v1/station"), ("POST", "/api/v1/station/arm")):
                answer = client.request(method, path)
                assert (answer.status_code, answer.json()["code"]) == (503, "storage-full"), path
                assert answer.json()["action"] == "Free space."
            page.report(BusyError("No memory.", code="ring-too-large"))
            assert client.get("/healthz").json()["code"] == "ring-too-large"
        # The station's own server takes the socket over.
        assert listener.getsockname()[1] == int(address.rpartition(":")[2])


@pytest.mark.parametrize(
    ("root_path", "path", "stated"),
    [("/aoi", "/aoi/", {}), ("/aoi", "/aoi/x", {}), ("", "/", {"X-Forwarded-Prefix": "/aoi"})],
)
def test_behind_a_proxy_the_page_finds_its_style_below_the_prefix(
    root_path: str, path: str, stated: dict[str, str]
) -> None:
    browser = {"Accept": "text/html", **stated}
    with open_listener("127.0.0.1", 0, "test") as listener:
        address = f"http://127.0.0.1:{listener.getsockname()[1]}"
        page = WaitingPage(listener, [], root_path=root_path)
        with page, httpx2.Client(base_url=address, headers=browser) as client:
            page.report(DeviceError("The disk is full.", code="storage-full"))
            assert 'href="/aoi/web/style.css"' in client.get(path).text
            style = client.get("/aoi/web/style.css" if root_path else "/web/style.css")
            assert style.headers["content-type"].startswith("text/css")
            api = client.get(f"{root_path}/api/v1/station").json()
            assert (api["code"], api["instance"]) == ("storage-full", "/aoi/api/v1/station")
