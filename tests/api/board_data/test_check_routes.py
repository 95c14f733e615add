"""Checks of board types over REST, and the correction."""

from __future__ import annotations

from typing import Any

from tests.api.held_station import HeldStation
from vaoi_station.board_check.report import BoardCheck
from vaoi_station.model import BoardType
from vaoi_station.runs.workers.board_check_job import CheckedBoard


def proposing(station: HeldStation) -> BoardCheck:
    """Make the station's checks propose a shifted board type."""
    board = station.board_type("demo-board")
    moved = board.model_copy(update={"state": "draft", "revision": "A corrected"})
    report = BoardCheck(board_type=board.name, score=9, rival_score=5, components=3, measured=3, proposal=moved)
    station.mosaics.board_checks._render = lambda job, name: CheckedBoard(report, b"jpeg")
    return report


def test_a_check_without_evidence_says_so(client: Any, station: HeldStation) -> None:
    run = station.film()
    answer = client.get(f"/api/v1/runs/{run}/board-check")
    assert answer.status_code == 200
    assert answer.json()["board_type"] == "demo-board"
    assert [w["code"] for w in answer.json()["warnings"]] == ["not-found"]
    tag = answer.headers["ETag"]
    assert client.get(f"/api/v1/runs/{run}/board-check", headers={"If-None-Match": tag}).status_code == 304
    picture = client.get(f"/api/v1/runs/{run}/board-check/picture", params={"board_type": "demo-board"})
    assert picture.headers["Content-Type"] == "image/jpeg"
    assert len(station.mosaics.jobs) == 1  # type: ignore[attr-defined]
    unknown = client.get(f"/api/v1/runs/{run}/board-check", params={"board_type": "nonsense"})
    assert unknown.status_code == 404
    refused = client.post("/api/v1/board-types/demo-board/correct", json={"run": run})
    assert (refused.status_code, refused.json()["code"]) == (409, "nothing-to-correct")


def test_a_change_that_comes_during_a_check_is_checked_as_well(client: Any, station: HeldStation) -> None:
    """Other changes do not wait for the check, and none of them is lost."""
    run = station.film()
    proposing(station)
    checks, asked = station.mosaics.board_checks, list[BoardType]()
    correct = checks.correct

    def changed_meanwhile(run: str, board_type: BoardType, revision: str | None) -> BoardType:
        asked.append(board_type)
        if len(asked) == 1:
            station.put_board_type(board_type.model_copy(update={"revision": "meanwhile"}))
        return correct(run, board_type, revision)

    checks.correct = changed_meanwhile  # type: ignore[method-assign]
    assert client.post("/api/v1/board-types/demo-board/correct", json={"run": run}).status_code == 200
    assert [board_type.revision for board_type in asked] == [None, "meanwhile"]


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
