"""Batches: prepared once, cut part by part, merged, and from recordings."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.api.held_station import HeldStation
from vaoi_station.errors import GoneError, InputError
from vaoi_station.files.images import write_image
from vaoi_station.rendering import ImageRequest
from vaoi_station.runs.batches.batches import Batch, BatchAccess, BatchPart, BatchRequest

ADDRESS = "/api/v1/runs/r000001/components"


@pytest.fixture
def station() -> HeldStation:
    station = HeldStation()
    station.film(board_id="SN-1")
    return station


def opened(access: BatchAccess, request: BatchRequest) -> Batch:
    return access.open("r000001", request, ADDRESS)


def test_the_head_names_run_and_request(station: HeldStation) -> None:
    request = BatchRequest(images=ImageRequest.of({"limit": 1}), container="zip")
    head = json.loads(opened(station.batches, request).head.content)
    assert {"run": "r000001", "board_id": "SN-1", "components": 3, "container": "zip"}.items() <= head.items()
    assert head["parameters"] == {"limit": 1}


def test_the_rest_of_a_part_comes_next(station: HeldStation, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vaoi_station.runs.batches.batch_job.PART_BYTES", 1)
    access = station.batches
    batch = opened(access, BatchRequest(format="raw", container="zip"))
    [part] = batch.parts()
    names: list[str] = []
    rest: BatchPart | None = part
    while rest is not None:
        found, rest = access.cut(batch, rest)
        names += [entry.name for entry in found.packed.entries]
        assert found.images <= 1
    assert names == list(dict.fromkeys(names))
    assert names[:3] == ["components/U1/views.json", "components/U1/0.raw", "components/U1/1.raw"]
    assert names[-1].startswith("components/2/R1/")


def test_merged_pictures_are_files_too(station: HeldStation) -> None:
    access = station.batches
    batch = opened(access, BatchRequest(components=("U1",), hdr=True, format="raw", container="zip"))
    found, rest = access.cut(batch, batch.parts()[0])
    assert rest is None
    assert [entry.name for entry in found.packed.entries] == ["components/U1/views.json", "components/U1/merged.raw"]
    name = b"views.json"  # the bytes before it hold the date and a checksum, in which there may be a brace
    start = found.packed.content.index(name) + len(name)
    document = json.JSONDecoder().raw_decode(found.packed.content[start:].decode("latin-1"))[0]
    [view] = document["views"]
    assert found.packed.entries[1].size == 4 * view["width_px"] * view["height_px"]
    assert view["merged"]


def test_a_light_that_the_run_does_not_have_is_refused_before_the_first_byte(station: HeldStation) -> None:
    with pytest.raises(InputError, match="light is 'left'"):
        opened(station.batches, BatchRequest(images=ImageRequest.of({"light": "left"})))


def test_frames_that_have_gone_are_read_from_a_recording(station: HeldStation, tmp_path: Path) -> None:
    access = station.batches
    request = BatchRequest(components=("U1",), format="raw", container="zip")
    batch = opened(access, request)
    in_memory, _ = access.cut(batch, batch.parts()[0])

    def recorded(run: str, camera: int, row: int) -> Path:
        if row == 0:
            raise GoneError("This frame was not complete.")
        file = tmp_path / f"{camera}-{row}.png"
        write_image(file, station.pixels[run, camera, row])
        return file

    station.release("r000001")
    with pytest.raises(GoneError):
        opened(access, request)
    kept = BatchAccess(access.get, access.lease, recorded, access.render, access.merged)
    again = opened(kept, request)
    assert again.setup.files
    from_files, _ = kept.cut(again, again.parts()[0])
    expected = {e.crc for e in in_memory.packed.entries[1:]}
    assert 0 < len(from_files.packed.entries[1:]) < len(expected), "the recording lacks frames of row 3"
    assert {e.crc for e in from_files.packed.entries[1:]} <= expected
    with pytest.raises(GoneError):
        access.cut(batch, batch.parts()[0])


def test_the_end_states_whether_all_was_sent(station: HeldStation) -> None:
    batch = opened(station.batches, BatchRequest())
    assert json.loads(batch.end(9, 0, None).content)["complete"] is True
    cut = json.loads(batch.end(1, 0, GoneError("Too late.", code="frames-gone")).content)
    assert cut["complete"] is False
    assert cut["error"]["code"] == "frames-gone"
    assert np.isclose(json.loads(batch.head.content)["cameras_px_per_mm"], 8)
