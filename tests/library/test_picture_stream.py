"""The pictures of many components from one answer of a station."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest

import vaoi_station as vaoi
from tests.api.conftest import Served
from vaoi_station.library.picture_stream import ComponentPictures, read_pictures
from vaoi_station.runs.batches.containers import ContainerWriter, Member, pack


def test_pictures_of_all_components_are_those_of_single_requests(served: Served) -> None:
    run = vaoi.connect(served.url).run()
    found = {c.address: c for c in run.pictures(margin_mm=0.5)}
    assert set(found) == set(run.refs)
    for address, component in found.items():
        images = run.component(address, margin_mm=0.5)
        assert len(images.images) == len(component.pixels) == len(component.views)
        for image, view, pixels in zip(images, component.views, component.pixels, strict=True):
            assert (image.camera, image.row) == (view["camera"], view["row"])
            np.testing.assert_array_equal(image.pixels, pixels)


VIEW = {"width_px": 2, "height_px": 1, "channels": 3, "dtype": "uint16"}
VIEWS = Member("components/U1/views.json", "", json.dumps({"address": "U1", "views": [VIEW, VIEW]}).encode())
IMAGES = [Member(f"components/U1/{k}.raw", "", bytes([k]) * 12) for k in range(2)]
DONE = Member("end.json", "", b'{"complete": true}')


def read(*members: Member, cut: int = 0) -> list[ComponentPictures]:
    writer = ContainerWriter("multipart", 0)
    content = b"".join(writer.add(pack("multipart", [member], 0)) for member in members) + writer.end()
    return list(read_pictures(io.BytesIO(content[: len(content) - cut]), "http://station/images"))


@pytest.mark.parametrize("cut", [3, 40, 150])
def test_an_answer_that_is_cut_off_is_refused(cut: int) -> None:
    with pytest.raises(vaoi.DeviceError, match="batch"):
        read(VIEWS, *IMAGES, DONE, cut=cut)


@pytest.mark.parametrize(
    "members",
    [
        [VIEWS, *IMAGES],
        [VIEWS, IMAGES[0], DONE],
        [IMAGES[0], DONE],
        [VIEWS, *IMAGES, IMAGES[0], DONE],
        [Member("components/U1/views.json", "", b"{}"), DONE],
        [VIEWS, Member("components/U1/0.raw", "", b"short"), DONE],
    ],
)
def test_an_answer_of_another_kind_is_refused(members: list[Member]) -> None:
    with pytest.raises(vaoi.DeviceError, match="batch"):
        read(*members)
    with pytest.raises(vaoi.DeviceError, match="batch"):
        list(read_pictures(io.BytesIO(b"<html>"), "http://station/images"))
