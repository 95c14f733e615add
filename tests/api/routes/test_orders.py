"""Orders that wait, over REST."""

from __future__ import annotations

from typing import Any

import pytest

ORDERS = "/api/v1/orders"


def post(client: Any, board_id: str, **more: Any) -> Any:
    answer = client.post(ORDERS, json={"board_type": "demo-board", "board_id": board_id, **more})
    assert answer.status_code == 201, answer.text
    return answer.json()


def waiting(client: Any) -> list[str]:
    return [order["board_id"] for order in client.get(ORDERS).json()["orders"]]


def test_orders_are_given_moved_and_withdrawn(client: Any) -> None:
    first, _ = post(client, "b1", job_id="J1", skip=["2"], side="top"), post(client, "b2")
    assert {key: first[key] for key in ("board_type", "board_id", "job_id", "skip", "side", "priority", "state")} == {
        "board_type": "demo-board", "board_id": "b1", "job_id": "J1", "skip": ["2"], "side": "top", "priority": 0,
        "state": "waiting",
    }  # fmt: skip
    urgent = post(client, "b3", priority=1)
    assert waiting(client) == ["b3", "b1", "b2"]
    moved = client.patch(f"{ORDERS}/{urgent['id']}", json={"position": 3})
    assert (moved.status_code, moved.json()["id"], waiting(client)) == (200, urgent["id"], ["b1", "b2", "b3"])
    assert client.delete(f"{ORDERS}/{first['id']}").status_code == 204
    assert waiting(client) == ["b2", "b3"]
    assert client.delete(f"{ORDERS}/{first['id']}").json()["code"] == "unknown-order"


@pytest.mark.parametrize(
    ("wrong", "status", "says"),
    [
        ({"board_type": "other"}, 404, "other"),
        ({"skip": ["9"]}, 422, "skip is '9', but must be positions of board type 'demo-board': 2"),
        ({"side": "bottom"}, 422, "side is 'bottom', but must be top, the side that board type"),
        ({"board_id": "b1"}, 409, "is for board 'b1' already"),
        ({"priority": 9999}, 422, "priority"),
        ({"speed": 1}, 422, "speed"),
    ],
)
def test_an_order_that_cannot_be_is_refused(client: Any, wrong: dict[str, Any], status: int, says: str) -> None:
    post(client, "b1")
    refused = client.post(ORDERS, json={"board_type": "demo-board", "board_id": "b9", **wrong})
    assert refused.status_code == status
    assert says in refused.text
    assert waiting(client) == ["b1"]


@pytest.mark.parametrize("change", [{}, {"position": 1, "priority": 2}, {"position": 7}])
def test_a_change_without_one_possible_place_is_refused(client: Any, change: dict[str, int]) -> None:
    order = post(client, "b1")
    assert client.patch(f"{ORDERS}/{order['id']}", json=change).status_code == 422


def test_the_line_is_armed_for_orders_or_for_a_board_type(client: Any) -> None:
    assert client.post("/api/v1/station/arm?orders=true").json()["state"] == "armed"
    both = client.post("/api/v1/station/arm", json={"orders": True, "board_type": "demo-board"})
    assert (both.status_code, both.json()["detail"]) == (422, "orders excludes board_type.")
    lost = client.post("/api/v1/station/arm?orders=true&allow_lost_cameras=true")
    assert (lost.status_code, lost.json()["detail"]) == (422, "orders excludes allow_lost_cameras.")
    assert client.post("/api/v1/station/arm?orders=true&allow_lost_cameras=false").status_code == 200
