"""Checks of a station's replies, and what the public API makes of garbage."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest

import vaoi_station as vaoi
from tests.peers.web_server import ScriptedHandler, serving
from vaoi_station.files.images import encode_png
from vaoi_station.files.results import stitch_document

EYE = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
VIEW: dict[str, Any] = {
    "k": 0,
    "camera": 0,
    "row": 1,
    "coverage": 1.0,
    "off_center": 0.0,
    "width_px": 4,
    "height_px": 4,
    "px_per_mm": 8.0,
    "crop_from_cad": EYE,
    "cad_from_crop": EYE,
    "image_from_crop": EYE,
    "plane": "board",
    "height_mm": 0.0,
    "distorted": False,
    "url": "/api/v1/picture",
    "new": "of a newer station",
}
COMPONENT = {
    "address": "U1",
    "ref": "U1",
    "center_mm": [1, 2],
    "width_mm": 1,
    "height_mm": 1,
    "rotation_deg": 0,
    "views": 1,
    "unseen": False,
    "url": "/api/v1/component",
}
RESULT = stitch_document(
    vaoi.Result.model_validate(
        {"method": "auto", "image_matrices": [[EYE]], "cad_matrix": EYE, "row_motion": [EYE], "status": "ok"}
    )
)
REPLIES: dict[str, Any] = {
    "/station": {"state": "idle"},
    "/runs": {"runs": [{"id": "r1"}]},
    "/runs/next": {"id": "r1"},
    "/runs/latest": {"id": "r1"},
    "/runs/r1/matrices": RESULT,
    "/runs/r1/components": {"components": [COMPONENT]},
    "/runs/r1/components/U1": {"address": "U1", "views": [VIEW]},
    "/picture": encode_png(np.zeros((4, 4), np.uint8)),
}
USES: dict[str, Callable[[vaoi.Station], object]] = {
    "/station": lambda station: station.snapshot(),
    "/runs": lambda station: station.runs(),
    "/runs/next": lambda station: station.wait_for_run(),
    "/runs/latest": lambda station: station.run(),
    "/runs/r1/matrices": lambda station: station.run().result,
    "/runs/r1/components": lambda station: station.run().refs,
    "/runs/r1/components/U1": lambda station: station.run().component("U1"),
    "/picture": lambda station: station.run().component("U1")[0].pixels,
}

RIGHT: list[tuple[tuple[str | int, ...], Any]] = [
    (("id",), "x"),
    (("components", 0, "address"), "x"),
    (("runs", 0), {}),
    (("runs", 0), "absent"),
    (("views", 0, "url"), "x"),
]
"""Values of the test below that are right for their keys."""


class ScriptedReplies(ScriptedHandler):
    """Replies to each path with the entry of `replies`: an object as JSON, or bytes as they are."""

    replies: dict[str, Any] = {}  # noqa: RUF012  (each test sets it)

    def do_GET(self) -> None:  # noqa: N802  (the name is that of the base class)
        reply = self.replies[self.path.split("?")[0].removeprefix("/api/v1")]
        self.send(200, reply if isinstance(reply, bytes) else json.dumps(reply).encode())


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with serving(ScriptedReplies) as address:
        yield address


@pytest.mark.parametrize("garbage", [b"<html>", b'{"id": "r', b"[]", b"null", b"7", b""])
@pytest.mark.parametrize("path", USES)
def test_garbage_is_a_device_error_with_the_address(address: str, path: str, garbage: bytes) -> None:
    ScriptedReplies.replies = {**REPLIES, path: garbage}
    with pytest.raises(vaoi.DeviceError, match=rf"{address}/api/v1{path}(\?\S+)?: the station replied with"):
        USES[path](vaoi.Station(address))


@pytest.mark.parametrize("wrong", ["absent", {}, "x"])
@pytest.mark.parametrize(
    ("path", "keys"),
    [
        ("/runs", ("runs",)),
        ("/runs", ("runs", 0)),
        ("/runs/next", ("id",)),
        ("/runs/latest", ("id",)),
        ("/runs/r1/matrices", ("row_motion",)),
        ("/runs/r1/matrices", ("image_matrices", 0, 0, 0)),
        ("/runs/r1/components", ("components",)),
        ("/runs/r1/components", ("components", 0, "address")),
        ("/runs/r1/components/U1", ("views",)),
        *(("/runs/r1/components/U1", ("views", 0, key)) for key in VIEW if key not in ("new",)),
    ],
)
def test_absent_keys_and_wrong_types_are_device_errors(
    address: str, path: str, keys: tuple[str | int, ...], wrong: Any
) -> None:
    reply = copy.deepcopy(REPLIES[path])
    inner = reply
    for key in keys[:-1]:
        inner = inner[key]
    if wrong == "absent":
        del inner[keys[-1]]
    else:
        inner[keys[-1]] = wrong
    ScriptedReplies.replies = {**REPLIES, path: reply}
    expected = pytest.raises(vaoi.DeviceError, match=f"{address}/api/v1{path}")
    with nullcontext() if (keys, wrong) in RIGHT else expected:
        USES[path](vaoi.Station(address))


@pytest.mark.parametrize(
    "wrong",
    [None, 5, "", "127.0.0.1:8350", "ftp://a", "http://", "http://:80", "http://a:b", "http://a:99999", "http://[::1",
     "http://a b", "http://a\r\nX: y", "http://ä"],
)  # fmt: skip
def test_a_malformed_address_is_refused(wrong: Any) -> None:
    with pytest.raises(vaoi.InputError, match="address is"):
        vaoi.connect(wrong)


def test_wrong_arguments_are_refused_before_a_request(address: str) -> None:
    ScriptedReplies.replies = REPLIES
    station = vaoi.connect(address)
    run = station.run()
    wrong: Any
    for wrong in (None, 0, -1, 1.5, "5", True):
        with pytest.raises(vaoi.InputError, match="limit is"):
            station.runs(wrong)
    for wrong in (None, "", 5):
        with pytest.raises(vaoi.InputError, match="run_id is"):
            station.run(wrong)
    with pytest.raises(vaoi.InputError, match="px_per_mm is -1"):
        run.component("U1", px_per_mm=-1)
    with pytest.raises(vaoi.InputError, match="min_coverage is 2"):
        run.component("U1", min_coverage=2)
    with pytest.raises(vaoi.InputError, match="ref is 5"):
        run.component(5)  # type: ignore[arg-type]
