"""Cameras that cannot do what is planned, or do something else, are refused by name, with what to do."""

from __future__ import annotations

import gzip
import io
import zipfile
from collections.abc import Callable

import pytest

from tests.acquisition.cameras.aravis.stand_in import camera_config
from tests.needs import DESCRIPTIONS, need_descriptions
from vaoi_station.acquisition.cameras.aravis.connection import Connection
from vaoi_station.acquisition.cameras.aravis.discovery import discover, find
from vaoi_station.errors import DeviceError
from vaoi_station.rig.gige.camera import Camera

ACCESS_DENIED = 0x8006


def unparsable(camera: Camera) -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("camera.xml", "<RegisterDescription><Category")
    camera._file = packed.getvalue()
    camera.boot()


def refusing(camera: Camera) -> None:
    camera.faults.refuses["ExposureTimeAbs"] = ACCESS_DENIED


def keeping(camera: Camera) -> None:
    camera.faults.keeps["Width"] = 640


def restarting(camera: Camera) -> None:
    camera.faults.restarts_at = "ExposureTimeAbs"


def as_it_is(_camera: Camera) -> None:
    pass


def opened(camera: Camera, changes: dict[str, object]) -> None:
    connection = Connection(camera_config(**{"address": camera.address, **changes}), camera.address)
    try:
        connection.configure()
    finally:
        connection.close()


@pytest.mark.parametrize(
    ("fault", "changes", "code", "words"),
    [
        (unparsable, {}, "description-wrong", "answers, but its description cannot be read"),
        (unparsable, {"address": None, "serial": "S2"}, "description-wrong", "its description cannot be read"),
        (refusing, {}, "setting-refused", r"refuses ExposureTimeAbs = 250.0 .*access-denied"),
        (keeping, {}, "setting-ignored", "Width was set to 16, but reads 640"),
        (restarting, {}, "camera-lost", "has restarted or gone while it was set up .ignores a setting: Exposure"),
        (as_it_is, {"features": {"NoSuch": 3}}, "feature-absent", "has no feature NoSuch, which is to be 3"),
        (as_it_is, {"exposure_us": 5e8}, "setting-beyond-limits", r"ExposureTimeAbs = 5e\+08 is outside of .* 1e\+06"),
        (as_it_is, {"pixel_format": "Mono16"}, "setting-refused", "PixelFormat = 'Mono16' .*; it offers Mono8, "),
        (as_it_is, {"trigger_line": "Line9"}, "camera-without-input", "no trigger input Line9; it has Freerun, Line1"),
    ],
)
def test_a_camera_is_refused_by_name_with_what_to_do(
    fault: Callable[[Camera], None], changes: dict[str, object], code: str, words: str
) -> None:
    need_descriptions()
    text = gzip.decompress((DESCRIPTIONS / "AVT_Mako_G234B.xml.gz").read_bytes()).decode("utf-8-sig")
    camera = Camera("127.0.0.2", text, serial="S2")
    try:
        fault(camera)
        with pytest.raises(DeviceError, match=f"camera c0: .*{words}") as refused:
            opened(camera, changes)
        assert refused.value.code == code
        assert refused.value.action
    finally:
        camera.close()


def test_an_open_camera_has_the_model_that_a_search_states() -> None:
    """In its description, a Manta has the name of its model elsewhere, without the number of its variant."""
    need_descriptions()
    text = gzip.decompress((DESCRIPTIONS / "AVT_Manta_G507B.xml.gz").read_bytes()).decode("utf-8-sig")
    camera = Camera("127.0.0.2", text, serial="S2")
    try:
        camera.write(0x68, b"Manta G-507B (E0022704)\0")
        connection = Connection(camera_config(address=camera.address), camera.address)
        assert connection.identity.model == find("S2", discover(0.4)).model == "Manta G-507B (E0022704)"
        connection.close()
    finally:
        camera.close()
