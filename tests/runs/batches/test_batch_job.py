"""Jobs of batches: the same pictures and figures as one by one, in parts that end in time."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.api.held.replies import unpacked
from tests.api.held_station import HeldStation
from vaoi_station.api.rest_models import ViewEntry
from vaoi_station.errors import GoneError
from vaoi_station.model import Component
from vaoi_station.rendering import ImageRequest, render_chosen
from vaoi_station.rendering.selection import describe
from vaoi_station.runs.batches import batch_job
from vaoi_station.runs.batches.batch_job import folder_of
from vaoi_station.runs.batches.batches import BatchRequest
from vaoi_station.runs.batches.containers import ContainerWriter

RUN = "r000001"


def files_of(station: HeldStation, request: BatchRequest) -> dict[str, bytes]:
    access = station.batches
    batch = access.open(RUN, request, f"/api/v1/runs/{RUN}/components", "?q")
    writer, content, parts = ContainerWriter("zip", 0), b"", batch.parts()
    while parts:
        found, rest = access.cut(batch, parts.pop(0))
        content += writer.add(found.packed)
        parts = parts if rest is None else [rest, *parts]
    return unpacked(content + writer.end(), "zip")


@pytest.fixture(scope="module")
def station() -> HeldStation:
    station = HeldStation()
    station.lights = ("left", "right")
    station.film()
    return station


@pytest.mark.parametrize("options", [{}, {"light": "left", "limit": 1}, {"light": "left", "minus": "right"}])
def test_pictures_and_figures_are_those_of_single_requests(station: HeldStation, options: dict[str, str]) -> None:
    wanted = ImageRequest.of(options)  # type: ignore[arg-type]
    files = files_of(station, BatchRequest(images=wanted, format="npy", container="zip"))
    for address in ("U1", "R1", "2/R1"):
        folder = f"components/{address}"
        choices = station.images(RUN, address, wanted).chosen
        entry = json.loads(files[f"{folder}/views.json"])
        assert entry["address"] == address
        for k, (choice, view) in enumerate(zip(choices, entry["views"], strict=True)):
            url = f"/api/v1/runs/{RUN}/components/{address}/images/{k}?q"
            expected = ViewEntry(k=k, url=url, **describe(choice, None)).model_dump(mode="json", exclude_none=True)
            assert view == {**expected, "file": f"{folder}/{k}.npy"}
            frames = [station.pixels[RUN, s.view.camera, s.view.row] for s in (choice, choice.minus) if s]
            pixels = np.frombuffer(files[view["file"]][128:], np.uint8)
            np.testing.assert_array_equal(pixels, render_chosen(choice, *frames).ravel())


def test_a_batch_ends_although_every_choice_takes_longer_than_a_part(
    station: HeldStation, monkeypatch: pytest.MonkeyPatch
) -> None:
    wanted = BatchRequest(images=ImageRequest.of({"measure": True}), format="raw", container="zip")
    whole = files_of(station, wanted)
    monkeypatch.setattr(batch_job, "PART_S", -1.0)
    assert files_of(station, wanted).keys() == whole.keys()


def test_frames_that_are_lost_are_no_refusal_of_components(
    station: HeldStation, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost(*_: object) -> None:
        raise GoneError("The recording was deleted.")

    monkeypatch.setattr(batch_job, "measure", lost)
    with pytest.raises(GoneError):
        files_of(station, BatchRequest(images=ImageRequest.of({"measure": True}), container="zip"))


@pytest.mark.parametrize(
    ("ref", "folder"),
    [
        ("U1", "components/U1"),
        ("..", "components/%2E%2E"),
        ("a b/ü", "components/a%20b/%C3%BC"),
        (".x", "components/.x"),
    ],
)
def test_folders_never_lead_out_of_the_container(ref: str, folder: str) -> None:
    part = Component.model_construct(ref=ref, panel=None, center=(0.0, 0.0), width=1.0, height=1.0)
    assert folder_of(part, region=False) == folder
