"""Manifests are deterministic, and their places follow from what they say."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from vaoi_station.plant.archive.manifest import ArchivedRun, DocumentBlob, FrameBlob, frames_digest, station_folder


def test_the_size_of_a_run_counts_a_blob_once() -> None:
    head = DocumentBlob(sha256="a" * 64, bytes=10, packed=True)
    frames = (
        FrameBlob(sha256="b" * 64, bytes=100, camera=0, row=0),
        FrameBlob(sha256="b" * 64, bytes=100, camera=0, row=1),
    )
    run = ArchivedRun(
        run="r",
        station="s",
        time="2026-03-01T08:00:00Z",
        board_type="t",
        pixels=8,
        documents={"head": head},
        frames=frames,
    )
    assert run.bytes == 110
    assert run.key == "runs/s/2026-03-01/r.json"
    assert head.key == "blobs/aa/" + "a" * 64
    assert ArchivedRun.model_validate_json(run.text()) == run


def test_names_of_stations_are_single_folders() -> None:
    assert [station_folder(name) for name in ("line 1/top", "..", "Größe")] == [
        "line 1%2Ftop",
        "%2E%2E",
        "Gr%C3%B6%C3%9Fe",
    ]


def test_an_id_of_frames_depends_on_all_of_them() -> None:
    frame = FrameBlob(sha256="b" * 64, bytes=100, camera=0, row=0)
    assert frames_digest([frame]) != frames_digest([frame, frame])


@pytest.mark.parametrize("time", ["2026-02-30T10:00:00Z", "2026-03-01T25:00:00Z", "0000-03-01T10:00:00Z"])
def test_a_time_that_does_not_exist_is_refused(time: str) -> None:
    with pytest.raises(ValidationError, match="time"):
        ArchivedRun(run="r", station="s", time=time, board_type="t", pixels=8, documents={}, frames=())
