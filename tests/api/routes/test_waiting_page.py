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


def test_a_browser_gets_a_page_and_programs_the_cause_as_json() -> None:
    browser = {"Accept": "text/html,application/xhtml+xml,*/*;q=0.8"}
    with open_listener("127.0.0.1", 0, "test") as listener:
        address = f"http://127.0.0.1:{listener.getsockname()[1]}"
        with WaitingPage(listener, ["127.0.0.1"]) as page, httpx2.Client(base_url=address, headers=browser) as client:
            page.report(DeviceError("The disk <a> is full.", action="Free space.", code="storage-full"))
            answer = client.get("/")
            assert (answer.status_code, answer.headers["content-type"]) == (503, "text/html; charset=utf-8")
            assert answer.headers["cache-control"] == "no-store"
            assert "The disk &lt;a&gt; is full. Free space." in answer.text
            assert client.get("/web/style.css").status_code == 200
            assert client.get("/api/v1/station").json()["code"] == "storage-full"
            assert client.post("/api/v1/station/arm").json()["code"] == "storage-full"


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


def test_a_name_that_is_not_known_yet_is_waited_for() -> None:
    with pytest.raises(DeviceError, match=r"cannot listen on nowhere\.invalid port 0") as refusal:
        open_listener("nowhere.invalid", 0, "test")
    assert refusal.value.code == "address-absent"
