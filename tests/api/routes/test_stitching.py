"""`board-types/{name}/reference` and `…/method` over REST."""

from __future__ import annotations

from typing import Any

import pytest

from vaoi_station.model import Status

TYPE = "/api/v1/board-types/demo-board"


def test_a_reference_is_set_read_and_deleted(client: Any, station: Any) -> None:
    none = client.get(f"{TYPE}/reference")
    assert (none.status_code, none.json()["code"]) == (404, "no-reference")
    first = client.put(f"{TYPE}/reference", json={"run": station.film()})
    assert (first.status_code, first.headers["location"]) == (201, f"{TYPE}/reference")
    assert {k: first.json()[k] for k in ("run", "board_type", "usable", "calibration", "rows", "cameras")} == {
        "run": "r000001", "board_type": "demo-board", "usable": True, "calibration": "c0ffee", "rows": 4, "cameras": 3,
    }  # fmt: skip
    assert client.get(f"{TYPE}/reference").json() == first.json()
    assert first.headers["cache-control"] == "no-store"
    second = client.put(f"{TYPE}/reference", json={"run": station.film()})
    assert (second.status_code, second.json()["run"]) == (200, "r000002")
    assert client.delete(f"{TYPE}/reference").status_code == 204
    assert client.delete(f"{TYPE}/reference").json()["code"] == "no-reference"


def test_a_method_is_changed_only_if_it_is_the_one_that_was_read(client: Any) -> None:
    read = client.get(f"{TYPE}/method").headers["etag"]
    first = client.put(f"{TYPE}/method", json={"method": "features"}, headers={"If-Match": read})
    assert first.headers["etag"] == client.get(f"{TYPE}/method").headers["etag"] != read
    for answer in (
        client.put(f"{TYPE}/method", json={"method": "fiducials"}, headers={"If-Match": read}),
        client.delete(f"{TYPE}/method", headers={"If-Match": read}),
    ):
        assert (answer.status_code, answer.json()["code"]) == (412, "changed")
    assert client.get(f"{TYPE}/method").json()["method"] == "features"


def test_of_two_who_teach_the_second_learns_that_there_is_another_reference(client: Any, station: Any) -> None:
    runs = [station.film() for _ in range(3)]
    first = client.put(f"{TYPE}/reference", json={"run": runs[0]}).headers["etag"]
    assert client.get(f"{TYPE}/reference").headers["etag"] == first
    second = client.put(f"{TYPE}/reference", json={"run": runs[1]}, headers={"If-Match": first}).headers["etag"]
    for answer in (
        client.put(f"{TYPE}/reference", json={"run": runs[2]}, headers={"If-Match": first}),
        client.delete(f"{TYPE}/reference", headers={"If-Match": first}),
    ):
        assert (answer.status_code, answer.json()["code"]) == (412, "changed")
    assert client.get(f"{TYPE}/reference").json()["run"] == runs[1]
    assert client.delete(f"{TYPE}/reference", headers={"If-Match": second}).status_code == 204
    assert client.put(f"{TYPE}/reference", json={"run": runs[2]}, headers={"If-Match": second}).status_code == 412


def test_unsuitable_runs_are_refused_as_reference(client: Any, station: Any) -> None:
    def refused(**body: Any) -> tuple[int, str]:
        answer = client.put(f"{TYPE}/reference", json=body)
        assert answer.headers["content-type"] == "application/problem+json"
        return answer.status_code, answer.json()["code"]

    assert refused() == (422, "invalid-input")
    assert refused(run="r000099") == (404, "unknown-run")
    assert refused(run=station.film(), extra=1) == (422, "invalid-input")
    assert refused(run=station.film(verdict=Status.DEGRADED)) == (409, "not-a-reference")
    gone = station.film()
    station.release(gone)
    assert refused(run=gone) == (410, "frames-gone")
    assert client.put("/api/v1/board-types/unheard/reference", json={"run": gone}).status_code == 404


def test_a_method_is_set_and_deleted(client: Any) -> None:
    assert client.get(f"{TYPE}/method").json() == {"method": "auto", "chosen": "station"}
    assert client.put(f"{TYPE}/method", json={"method": "reference"}).json() == {
        "method": "reference",
        "chosen": "board-type",
    }
    assert client.get(f"{TYPE}/method").json()["method"] == "reference"
    assert client.delete(f"{TYPE}/method").json() == {"method": "auto", "chosen": "station"}


@pytest.mark.parametrize("body", [{"method": "paper"}, {"method": None}, {}, {"method": "auto", "more": 1}])
def test_an_unknown_method_is_refused(client: Any, body: Any) -> None:
    answer = client.put(f"{TYPE}/method", json=body)
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid-input")
