"""A station over a real socket through the public API."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import vaoi_station as vaoi
from tests.api.conftest import Served
from tests.api.held_station import HeldStation


@pytest.fixture
def served() -> Iterator[Served]:
    station = HeldStation()
    station.film(board_id="SN-1")
    served = Served(station)
    yield served
    served.stop()


def test_the_latest_run_gives_images_of_a_component(served: Served) -> None:
    run = vaoi.connect(served.url).run()
    assert run.summary["board_id"] == "SN-1"
    assert run.status == vaoi.Status.OK
    assert run.refs == ("U1", "R1", "2/R1")
    images = run.component("U1")
    assert images.images
    for image in images:
        assert image.pixels.shape[:2] == (64, 80), "8 mm × 10 mm at 8 px/mm"
        assert image.crop_from_cad.shape == image.image_from_crop.shape == (3, 3)


def test_runs_are_listed_and_waited_for(served: Served) -> None:
    station = vaoi.connect(served.url)
    assert [run["id"] for run in station.runs()] == ["r000001"]
    assert station.wait_for_run(after="r000001", timeout_s=0.0) is None
    second = served.station.film()
    following = station.wait_for_run(after="r000001", timeout_s=5.0)
    assert following is not None
    assert following.id == second
    assert station.snapshot()["state"]


def test_refusals_are_the_errors_of_the_station(served: Served) -> None:
    station = vaoi.connect(served.url)
    with pytest.raises(vaoi.NotFoundError):
        station.run("r999999")
    with pytest.raises(vaoi.NotFoundError, match="U999"):
        station.run().component("U999")


def test_an_address_without_a_station_is_refused() -> None:
    with pytest.raises(vaoi.InputError, match="must start with http"):
        vaoi.connect("localhost:8350")
    with pytest.raises(vaoi.DeviceError, match="does not reply"):
        vaoi.connect("http://127.0.0.1:9")


def test_released_frames_are_gone(served: Served) -> None:
    run = vaoi.connect(served.url).run()
    images = run.component("U1")
    run.release()
    with pytest.raises(vaoi.GoneError):
        _ = images[0].pixels
