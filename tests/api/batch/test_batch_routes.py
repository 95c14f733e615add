"""The pictures of many components in one answer."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest

from tests.api.held.pictures import RUNS, picture
from tests.api.held.unpacked import documents, unpacked
from vaoi_station.api.batch import batch_stream
from vaoi_station.runs.batches.containers import CONTAINERS, MEDIA_TYPES


@pytest.mark.parametrize("container", CONTAINERS)
def test_all_pictures_of_a_run_in_every_container(shared_client: Any, container: str) -> None:
    answer = shared_client.get(f"{RUNS}/r000001/images", params={"container": container})
    assert answer.status_code == 200
    assert answer.headers["content-type"] == MEDIA_TYPES[container]  # type: ignore[index]
    files = unpacked(answer.content, container)
    assert next(iter(files)) == "run.json"
    assert list(files)[-1] == "end.json"
    found = documents(files)
    end = found.pop("end.json")
    assert found.pop("run.json")["run"] == "r000001"
    assert sorted(found) == [f"components/{ref}/views.json" for ref in ("2/R1", "R1", "U1")]
    views = [view for document in found.values() for view in document["views"]]
    assert end == {"complete": True, "components": 3, "refused": 0, "images": len(views)}
    assert {view["file"] for view in views} | set(found) | {"run.json", "end.json"} == set(files)


def test_each_file_is_the_picture_at_its_address(shared_client: Any) -> None:
    answer = shared_client.get(
        f"{RUNS}/r000001/images?component=U1&component=2/R1&container=zip&format=png&limit=2&margin_mm=1"
    )
    files = unpacked(answer.content, "zip")
    for name, document in documents(files).items():
        for view in document.get("views", ()):
            assert "margin_mm=1" in view["url"], name
            assert shared_client.get(view["url"]).content == files[view["file"]]
    assert "components/R1/views.json" not in files


def test_numpy_opens_the_answer(shared_client: Any) -> None:
    answer = shared_client.get(f"{RUNS}/r000001/images?component=R1&container=npz")
    arrays = np.load(io.BytesIO(answer.content))
    single = shared_client.get(f"{RUNS}/r000001/components/R1/images/0?format=npy")
    np.testing.assert_array_equal(arrays["components/R1/0"], picture(single))
    assert arrays["end.json"].startswith(b"{")


@pytest.mark.parametrize(
    ("query", "status", "code"),
    [
        ("component=U9", 404, "unknown-component"),
        ("component=", 422, "invalid-input"),
        ("light=left", 422, "invalid-input"),
        ("format=gif", 422, "invalid-input"),
        ("container=npz&format=png", 422, "invalid-input"),
        ("within=1,2,3", 422, "invalid-input"),
        ("within=0,0,a,b", 422, "invalid-input"),
        ("region=nan,0,1,1", 422, "invalid-input"),
        ("region=0,0,9,9&component=U1", 422, "invalid-input"),
        ("hdr=true&limit=1", 422, "invalid-input"),
        ("comp=U1", 422, "unknown-parameter"),
    ],
)
def test_what_cannot_be_answered_is_refused_before_the_stream(
    shared_client: Any, query: str, status: int, code: str
) -> None:
    answer = shared_client.get(f"{RUNS}/r000001/images?{query}")
    assert (answer.status_code, answer.json()["code"]) == (status, code)


def test_gone_frames_and_unknown_runs(client: Any, station: Any) -> None:
    run = station.film()
    station.release(run)
    assert client.get(f"{RUNS}/{run}/images").status_code == 410
    assert client.get(f"{RUNS}/never/images").status_code == 404


def test_frames_that_go_meanwhile_end_the_batch_with_the_cause(
    client: Any, station: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = station.film()
    opened = station.batches.open

    def open_then_release(*asked: Any) -> Any:
        found = opened(*asked)
        station.release(run)
        return found

    monkeypatch.setattr(type(station.batches), "open", lambda _self, *asked: open_then_release(*asked))
    files = unpacked(client.get(f"{RUNS}/{run}/images?container=tar").content, "tar")
    end = documents(files)["end.json"]
    assert end["complete"] is False
    assert end["error"]["code"] == "frames-gone"
    assert list(files) == ["run.json", "end.json"]


def test_a_fault_of_the_station_ends_the_batch_too(shared_client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> Any:
        raise RuntimeError("a secret path /etc/passwd")

    monkeypatch.setattr("vaoi_station.runs.batches.batches.BatchAccess.cut", fail)
    content = shared_client.get(f"{RUNS}/r000001/images?container=tar").content
    end = documents(unpacked(content, "tar"))["end.json"]
    assert end["error"]["code"] == "internal"
    assert b"passwd" not in content


def test_head_cuts_nothing(shared_client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vaoi_station.runs.batches.batches.BatchAccess.cut", lambda *_: pytest.fail("it is not read"))
    answer = shared_client.head(f"{RUNS}/r000001/images?container=tar")
    assert (answer.status_code, answer.content) == (200, b"")
    assert answer.headers["content-type"] == "application/x-tar"
    assert "content-length" not in answer.headers, "GET states none"


def test_only_a_few_parts_are_cut_ahead_of_the_reader() -> None:
    assert batch_stream.PARTS_AHEAD <= 4
