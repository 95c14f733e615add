"""Batches: prepared once, cut part by part, merged, and from recordings."""

from __future__ import annotations

from pathlib import Path

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


def pictures(access: BatchAccess, batch: Batch) -> list[int]:
    """Cut the first part of a batch and all that remains of it; return the checksums of its pictures."""
    found: list[int] = []
    rest: BatchPart | None = batch.parts()[0]
    while rest is not None:
        cut, rest = access.cut(batch, rest)
        found += [entry.crc for entry in cut.packed.entries if entry.name.endswith(".raw")]
    return found


def test_a_light_that_the_run_does_not_have_is_refused_before_the_first_byte(station: HeldStation) -> None:
    with pytest.raises(InputError, match="light is 'left'"):
        opened(station.batches, BatchRequest(images=ImageRequest.of({"light": "left"})))


def test_frames_that_have_gone_are_read_from_a_recording(station: HeldStation, tmp_path: Path) -> None:
    access = station.batches
    request = BatchRequest(components=("U1",), format="raw", container="zip")
    batch = opened(access, request)
    in_memory = set(pictures(access, batch))

    def recorded(run: str, camera: int, row: int) -> Path:
        if row == 0:
            raise GoneError("This frame was not complete.")
        file = tmp_path / f"{camera}-{row}.png"
        write_image(file, station.pixels[run, camera, row])
        return file

    station.release("r000001")
    with pytest.raises(GoneError):
        opened(access, request)
    kept = BatchAccess(access.get, access.explained, access.lease, recorded, access.render, access.merged)
    again = opened(kept, request)
    assert again.setup.files
    from_files = pictures(kept, again)
    assert 0 < len(from_files) < len(in_memory), "the recording lacks frames of row 0"
    assert set(from_files) <= in_memory
    with pytest.raises(GoneError):
        access.cut(batch, batch.parts()[0])
