"""Imports of board data over REST."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from fastapi.testclient import TestClient

from tests.api.held_station import HeldStation
from tests.api.routes.test_previews import import_here
from tests.board_data.readers import samples
from vaoi_station.api import middleware
from vaoi_station.api.app import create_app
from vaoi_station.api.routes import board_data
from vaoi_station.model import BoardType

PREVIEWS = "/api/v1/board-data/previews"
TABLE = "Ref,X(mm),Y(mm),Rot\nR1,110,10,0\nJ1,130,20,90\nFID1,105,5,0\nFID2,140,5,0\n"


@pytest.fixture(scope="module")
def held() -> HeldStation:
    return HeldStation()


@pytest.fixture(scope="module")
def client(held: HeldStation) -> Iterator[TestClient]:
    """One service for all tests: each builds its OpenAPI document at the first request."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(board_data, "import_limited", import_here)
        with TestClient(create_app(held, ["testserver"]), raise_server_exceptions=False) as client:
            yield client


def upload(client: Any, content: str = TABLE, filename: str = "p.csv", **options: str) -> dict[str, Any]:
    answer = client.post(PREVIEWS, params={"filename": filename, **options}, content=content.encode())
    assert answer.status_code == 201, answer.text
    assert answer.headers["location"] == f"{PREVIEWS}/{answer.json()['id']}"
    return dict(answer.json())


def test_from_upload_to_board_type(client: Any, held: HeldStation) -> None:
    found = upload(client, name="new")["found"]
    assert found["table"]["columns"][1] == {"name": "x", "number": 2, "header": "X(mm)"}
    assert [m["what"] for m in found["missing"]] == ["outline", "sizes", "heights", "sides"]
    listed = client.get(PREVIEWS).json()["previews"][-1]
    picture = client.get(listed["picture"])
    assert picture.headers["content-type"] == "image/svg+xml"
    assert "R1</text>" in picture.text
    assert picture.headers["content-security-policy"] == "default-src 'none'; style-src 'unsafe-inline'; sandbox"
    assert client.get(listed["board_type"]).json()["name"] == "new"
    answer = client.post(f"{PREVIEWS}/{listed['id']}/confirm")
    assert (answer.status_code, answer.headers["location"]) == (201, "/api/v1/board-types/new")
    assert [c.ref for c in held.types["new"].components] == ["R1", "J1", "FID1", "FID2"]
    assert client.get(f"{PREVIEWS}/{listed['id']}").status_code == 404


def test_a_board_type_is_replaced_under_the_condition_of_its_caller(client: Any, held: HeldStation) -> None:
    first = client.post(f"{PREVIEWS}/{upload(client, name='twice')['id']}/confirm", headers={"If-None-Match": "*"})
    assert (first.status_code, first.headers["etag"]) == (201, client.get("/api/v1/board-types/twice").headers["etag"])
    kept, other = held.types["twice"], upload(client, TABLE.replace("R1", "R2"), name="twice")
    for headers in ({"If-None-Match": "*"}, {"If-Match": '"0"'}):
        refused = client.post(f"{PREVIEWS}/{other['id']}/confirm", headers=headers)
        assert (refused.status_code, refused.json()["code"]) == (412, "changed")
        assert held.types["twice"] == kept
    stored = client.post(f"{PREVIEWS}/{other['id']}/confirm", headers={"If-Match": first.headers["etag"]})
    assert (stored.status_code, held.types["twice"].components[0].ref) == (200, "R2")
    last = client.post(f"{PREVIEWS}/{upload(client, name='twice')['id']}/confirm")
    assert (last.status_code, last.content) == (200, first.content)


def test_an_upload_that_is_repeated_with_its_key_makes_one_preview(client: Any) -> None:
    def send(content: str = TABLE, **options: str) -> Any:
        query = {"filename": "p.csv", **options}
        return client.post(PREVIEWS, params=query, content=content.encode(), headers={"Idempotency-Key": '"one"'})

    first, again = send(), send()
    assert (again.status_code, again.json()["id"]) == (201, first.json()["id"])
    assert again.headers["idempotency-replayed"] == "true"
    assert sum(p["id"] == first.json()["id"] for p in client.get(PREVIEWS).json()["previews"]) == 1
    for other in (send(TABLE + "R9,1,1,0\n"), send(side="bottom")):
        assert (other.status_code, other.json()["code"]) == (422, "key-of-another-request")


def test_options_are_corrected_and_files_joined(client: Any) -> None:
    bodies = upload(client, samples.KICAD, "b.kicad_pcb")
    places = upload(client, TABLE.replace("(mm)", ""))
    assert places["found"]["table"]["unit"] == "mm"
    answer = client.put(f"{PREVIEWS}/{places['id']}", json={"join": bodies["id"], "columns": "rotation=4"})
    assert answer.json()["found"]["format"] == "centroid + kicad"
    assert answer.json()["found"]["cut_outs"] == 1
    assert client.put(f"{PREVIEWS}/{places['id']}", json={"units": "cm"}).status_code == 422
    panel = {"repeat": "2x2", "pitch": "60x50", "rotate": "0,180", "border": "5x5"}
    found = client.put(f"{PREVIEWS}/{bodies['id']}", json=panel).json()["found"]
    assert (found["boards"], found["components"], found["size_mm"]) == (4, 12, [120.0, 105.0])
    address = f"{PREVIEWS}/{bodies['id']}/board-type"
    assert {c["panel"] for c in client.get(address).json()["components"]} == {"1", "2", "3", "4"}
    refused = client.put(f"{PREVIEWS}/{bodies['id']}", json={"repeat": "2x2"}).json()["refusal"]
    assert "--repeat 2x2 needs --pitch" in refused


def test_an_empty_upload_and_a_too_large_one_are_refused(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    answer = client.post(PREVIEWS, params={"filename": "x"}, content=b"")
    assert answer.json()["detail"] == "body: is empty, but must be the file."
    monkeypatch.setattr(middleware, "MAX_UPLOAD_BYTES", 10)
    answer = client.post(PREVIEWS, params={"filename": "x"}, content=b"x" * 11)
    assert (answer.status_code, "is 11 bytes; it must be at most 10" in answer.json()["detail"]) == (413, True)
    pieces = client.post(PREVIEWS, params={"filename": "x"}, content=iter([b"x"]))
    assert (pieces.status_code, "is not stated" in pieces.json()["detail"]) == (413, True)


def test_a_preview_that_is_deleted_while_it_is_confirmed_is_stored(
    client: Any, held: HeldStation, monkeypatch: pytest.MonkeyPatch
) -> None:
    preview, put = upload(client, name="gone"), held.put_board_type

    def put_and_delete(board_type: BoardType) -> bool:
        new = put(board_type)
        assert client.delete(f"{PREVIEWS}/{preview['id']}").status_code == 204
        return new

    monkeypatch.setattr(held, "put_board_type", put_and_delete)
    assert client.post(f"{PREVIEWS}/{preview['id']}/confirm").status_code == 201
