"""The pictures of many components in one answer: files, order of readiness, bounded work ahead, and the end."""

from __future__ import annotations

import asyncio
from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest

from tests.api.held.replies import RUNS, documents, unpacked
from vaoi_station.api.batch import PARTS_AHEAD, stream
from vaoi_station.runs.batches.batch_job import CutPart
from vaoi_station.runs.batches.batches import Batch, BatchPart
from vaoi_station.runs.batches.containers import CONTAINERS, MEDIA_TYPES, Member, Packed, pack


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


@pytest.mark.parametrize(
    ("query", "status", "code"),
    [
        ("component=U9", 404, "unknown-component"),
        ("component=", 422, "invalid-input"),
        ("light=left", 422, "invalid-input"),
        ("format=gif", 422, "invalid-input"),
        ("container=tar", 422, "invalid-input"),
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
    files = unpacked(client.get(f"{RUNS}/{run}/images?container=zip").content, "zip")
    end = documents(files)["end.json"]
    assert end["complete"] is False
    assert end["error"]["code"] == "frames-gone"
    assert list(files) == ["run.json", "end.json"]


def batch(count: int) -> Any:
    parts = [BatchPart((), k) for k in range(count)]
    made: Any = SimpleNamespace(
        run="r1",
        components=parts,
        request=SimpleNamespace(container="multipart"),
        modified_s=0,
        head=Member("run.json", "", b"head"),
        parts=lambda: list(parts),
        pack=lambda m: pack("multipart", [m], 0),
    )
    made.end = partial(Batch.end, made)
    return made


def reply(content: bytes) -> CutPart:
    return CutPart(Packed(content), 1, 0, None)


def test_a_reader_that_waits_stops_the_work() -> None:
    async def check() -> None:
        begun = []

        async def cut(part: BatchPart) -> tuple[CutPart, None]:
            begun.append(part.image)
            return reply(b"x"), None

        answer = stream(batch(50), cut)
        await anext(answer)
        assert begun == []
        await anext(answer)
        assert len(begun) <= PARTS_AHEAD
        await answer.aclose()  # type: ignore[attr-defined]  # it is a generator
        assert len(begun) <= PARTS_AHEAD

    asyncio.run(check())
