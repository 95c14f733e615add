"""Board types over REST: documents, versions, reference, method, light program, and the check against a run."""

from __future__ import annotations

from typing import Any
from urllib.parse import quote

import pytest
from hypothesis import strategies as st

from tests.api.held_station import HeldStation
from vaoi_station.board_check.report import BoardCheck
from vaoi_station.model import Status
from vaoi_station.runs.workers.picture_jobs import CheckedBoard

TYPES = "/api/v1/board-types"
U1 = {"ref": "U1", "center": [1, 2], "width": 3, "height": 4}
NEW = {"name": "new", "components": [U1], "x_note": {"a": 1}}


def test_a_board_type_is_created_and_replaced(client: Any) -> None:
    first = client.put(f"{TYPES}/new", json=NEW)
    assert (first.status_code, first.headers["location"]) == (201, f"{TYPES}/new")
    assert client.put(f"{TYPES}/new", json=NEW).status_code == 200
    assert client.get(f"{TYPES}/new").json() == first.json()


def test_of_two_who_edit_a_board_type_the_second_learns_that_it_has_changed(client: Any) -> None:
    read = client.put(f"{TYPES}/new", json=NEW).headers["etag"]
    mine = client.put(f"{TYPES}/new", json=NEW | {"side": "bottom"}, headers={"If-Match": read})
    assert mine.status_code == 200
    for change in (
        client.put(f"{TYPES}/new", json=NEW, headers={"If-Match": read}),
        client.delete(f"{TYPES}/new", headers={"If-Match": read}),
        client.post(f"{TYPES}/new/revisions/20260101T120000000Z-00000000/restore", headers={"If-Match": read}),
        client.put(f"{TYPES}/new/state", json={"state": "approved"}, headers={"If-Match": read}),
        client.put(f"{TYPES}/new", json=NEW, headers={"If-None-Match": "*"}),
    ):
        assert (change.status_code, change.json()["code"]) == (412, "changed")
    assert client.get(f"{TYPES}/new").json()["side"] == "bottom"
    now = {"If-Match": mine.headers["etag"]}
    mine = client.put(f"{TYPES}/new/state", json={"state": "approved"}, headers=now)
    assert (mine.json()["state"], mine.headers["etag"]) == ("approved", client.get(f"{TYPES}/new").headers["etag"])
    assert client.delete(f"{TYPES}/new", headers={"If-Match": mine.headers["etag"]}).status_code == 204


@pytest.mark.parametrize("name", ["Größe 1", "a+b (c)", "100%", "x&y=z", "Ω"])
def test_names_with_any_letters_are_accepted(client: Any, name: str) -> None:
    address = f"{TYPES}/{quote(name)}"
    assert client.put(address, json=NEW | {"name": name}).headers["location"] == address
    assert client.get(address).json()["name"] == name
    assert client.delete(address).status_code == 204
    assert client.get(address).status_code == 404


def test_a_board_type_in_use_is_not_deleted(client: Any) -> None:
    client.post("/api/v1/station/arm?board_type=demo-board")
    assert client.delete(f"{TYPES}/demo-board").status_code == 409


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)


def test_what_was_replaced_or_deleted_is_listed_read_and_restored(client: Any) -> None:
    client.put(f"{TYPES}/new", json=NEW)
    client.put(f"{TYPES}/new", json=NEW | {"side": "bottom"})
    client.delete(f"{TYPES}/new")
    assert client.get(TYPES).json()["deleted"] == ["new"]
    newest, oldest = client.get(f"{TYPES}/new/revisions").json()["revisions"]
    assert client.get(f"{TYPES}/new/revisions/{newest['id']}").json()["side"] == "bottom"
    restored = client.post(f"{TYPES}/new/revisions/{oldest['id']}/restore")
    assert restored.status_code == 200
    assert client.get(f"{TYPES}/new").json() == restored.json()
    assert client.get(TYPES).json()["deleted"] == []


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


PATH = "/api/v1/board-types/demo-board/program/check"


def test_a_program_is_checked_and_nothing_is_changed(client: Any, station: Any) -> None:
    before = station.types["demo-board"]
    answer = client.post(PATH, json={"program": [{"light": "left", "on_us": 900.0}]})
    assert answer.status_code == 200
    assert answer.headers["Cache-Control"] == "no-store"
    content = answer.json()
    assert (content["usable"], content["origin"]) == (False, "request")
    assert content["faults"][0]["message"].endswith(
        "must be 50 … 500 (the longest pulse of channel 2 in its firmware)."
    )
    assert station.types["demo-board"] is before
    assert client.post(PATH, json={}).json()["origin"] == "cameras"


def proposing(station: HeldStation) -> BoardCheck:
    """Make the station's checks propose a shifted board type."""
    board = station.board_type("demo-board")
    moved = board.model_copy(update={"state": "draft", "revision": "A corrected"})
    report = BoardCheck(board_type=board.name, score=9, rival_score=5, components=3, measured=3, proposal=moved)
    station.mosaics.board_checks._render = lambda job, name: CheckedBoard(report, b"jpeg")
    return report


def test_a_correction_is_stored_as_a_draft_of_the_version_that_was_read(client: Any, station: HeldStation) -> None:
    run = station.film()
    proposing(station)
    path = "/api/v1/board-types/demo-board/correct"
    assert client.post(path, json={"run": run}, headers={"If-Match": '"other"'}).status_code == 412
    tag = client.get("/api/v1/board-types/demo-board").headers["ETag"]
    stored = client.post(path, json={"run": run, "revision": "B"}, headers={"If-Match": tag})
    assert stored.status_code == 200, stored.text
    assert (stored.json()["state"], stored.json()["revision"]) == ("draft", "B")
    assert client.get("/api/v1/board-types/demo-board").json()["revision"] == "B"
