"""Every operation of the REST interface is a method of the Python client, or is left out for a named reason.

A server replies to every operation with the example of the OpenAPI document. All methods are called; what they asked
for is compared with the document, so that a new operation cannot be forgotten.
"""

from __future__ import annotations

import inspect
import io
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar
from urllib.parse import urlsplit

import numpy as np
import pytest

import vaoi_station as vaoi
from tests.peers.web_server import ScriptedHandler, serving
from vaoi_station.files.images import encode_png

DOCUMENT = json.loads((Path(__file__).parents[1] / "api" / "openapi.json").read_text(encoding="utf-8"))
_PAGE = "for the operator's page, whose viewers read these addresses themselves"
_ADMINISTRATOR = "for administrators, who use the page, `vaoi` or one plain request"
_DRAWN = "made for drawings of the operator's page"
_MONITORING = "for systemd, monitoring and the checks of set-up pages, which read it without a client"
LEFT_OUT = {
    **dict.fromkeys(("get_dzi", "get_dzi_tile"), _PAGE),
    **dict.fromkeys(("log_in", "log_out", "get_session"), _PAGE),
    **dict.fromkeys(("get_overlay", "get_trends", "compare_trends", "get_kept_mosaic", "get_part_picture"), _DRAWN),
    **dict.fromkeys(
        (
            "get_camera_picture",
            "get_camera_frame",
            "check_light_program",
            "get_camera_trial_picture",
            "try_camera_settings",
            "end_camera_trial",
        ),
        _DRAWN,
    ),
    **dict.fromkeys(("get_neighbours", "remove_board"), "for a person at the line, on the page"),
    "get_limits": "they are `limits` of the board type",
    "get_good_boards": "the replies to `keep_as_good` and `remove_from_good` list them",
    **dict.fromkeys(("list_import_previews", "get_import_preview"), "a StationImport holds its document"),
    **dict.fromkeys(
        ("plan_optics", "get_optics_requirements"), "the arithmetic of `vaoi plan`, which needs no station"
    ),
    **dict.fromkeys(("get_health", "get_readiness", "examine_station"), _MONITORING),
    **{
        item["operationId"]: _ADMINISTRATOR
        for path in DOCUMENT["paths"].values()
        for item in path.values()
        if item.get("x-scope") == "admin"
    },
}
"""For every operation that the client does not have, why."""


def _templates() -> Iterator[tuple[str, re.Pattern[str], str]]:
    """Yield method, pattern of the path, and id of every operation; longer paths and fixed ones first."""
    for path in sorted(DOCUMENT["paths"], key=lambda p: (-p.count("/"), p.count("{"))):
        pattern = re.sub(r"\\\{ref\\\}", ".+", re.escape(path))
        pattern = re.sub(r"\\\{\w+\\\}", "[^/]+", pattern)
        for method, operation in DOCUMENT["paths"][path].items():
            yield method.upper(), re.compile(pattern), operation["operationId"]


OPERATIONS = tuple(_templates())
_NPY = io.BytesIO()
np.save(_NPY, np.zeros((2, 3), np.float32))
_HEAD = '--b\r\nContent-Type: {}\r\nContent-Length: {}\r\nContent-Disposition: attachment; filename="{}"\r\n\r\n'


def _multipart() -> bytes:
    views = {"address": "U1", "views": [{"channels": 1, "height_px": 1, "width_px": 2, "dtype": "uint8"}]}
    files = {
        "run.json": b"{}",
        "U1/views.json": json.dumps(views).encode(),
        "U1/0.raw": b"\x01\x02",
        "end.json": b'{"complete": true}',
    }
    parts = [_HEAD.format("x/y", len(c), name).encode() + c + b"\r\n" for name, c in files.items()]
    return b"".join(parts) + b"--b--\r\n"


CONTENTS = {
    "get_component_image": encode_png(np.zeros((4, 4), np.uint8)),
    "get_frame": _NPY.getvalue(),
    "get_merged_image": _NPY.getvalue(),
    "get_images": _multipart(),
    "get_board_check_picture": b"\xff\xd8 a picture",
    "get_import_picture": b"<svg/>",
    "download_mosaic": b"II*\0",
    "stream_events": b'id: 7\ndata: {"number": 7}\n\n',
}
"""What the server sends for operations that do not reply with JSON."""


class Examples(ScriptedHandler):
    """Replies to every operation with its example, and notes which operations were asked for."""

    asked: ClassVar[dict[str, dict[str, str]]] = {}
    """Headers of the last request of each operation."""

    def answer(self) -> None:
        path = urlsplit(self.path).path
        self.rfile.read(int(self.headers.get("Content-Length") or 0))
        operation = next(o for m, p, o in OPERATIONS if m == self.command and p.fullmatch(path))
        Examples.asked[operation] = dict(self.headers)
        item = next(i for p in DOCUMENT["paths"].values() for i in p.values() if i["operationId"] == operation)
        status = min(s for s in item["responses"] if s.startswith("2"))
        example = item["responses"][status].get("content", {}).get("application/json", {}).get("example")
        content = b"" if example is None else json.dumps({**example, "of_a_newer_station": 1}).encode()
        if operation in ("get_board_type", "get_matrices") or "BoardType'" in str(item["responses"][status]):
            content = json.dumps(example).encode()  # documents with keys of the user refuse others
        self.send(int(status), CONTENTS.get(operation, content))

    do_GET = do_PUT = do_POST = do_PATCH = do_DELETE = answer  # noqa: N815  (the names are the base class's)


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with serving(Examples) as address:
        yield address


def _calls(station: vaoi.Station, folder: Path) -> dict[type, dict[str, Callable[[Any], Any]]]:
    """Return a call of every public method and property of the client's classes."""
    board = station.board_types.get("demo")
    file = folder / "board.csv"
    file.write_text("Ref,X,Y,Rotation\n")
    of_station: dict[str, Callable[[Any], Any]] = {
        "snapshot": lambda s: s.snapshot(),
        "arm": lambda s: s.arm("demo", runs=1, passing="wait"),
        "arm_for_orders": lambda s: s.arm_for_orders(),
        "orders": lambda s: s.orders(),
        "add_order": lambda s: s.add_order("demo", board_id="SN-1", skip=["2"]),
        "move_order": lambda s: s.move_order("01m8maam97-kez5a5", position=1),
        "withdraw_order": lambda s: s.withdraw_order("01m8maam97-kez5a5"),
        "disarm": lambda s: s.disarm(),
        "events": lambda s: list(s.events(0)),
        "runs": lambda s: s.runs(1, verdict="ok"),
        "board": lambda s: s.board("SN-1"),
        "counts": lambda s: s.counts(),
        "calibration": lambda s: s.calibration(),
        "run": lambda s: (s.run(), s.run("r1")),
        "wait_for_run": lambda s: s.wait_for_run(after="r1", timeout_s=0.0),
        "upload_board_data": lambda s: s.upload_board_data(file),
        "board_types": lambda s: s.board_types,
    }
    of_run: dict[str, Callable[[Any], Any]] = {
        "id": lambda r: r.id,
        "summary": lambda r: r.summary,
        "result": lambda r: r.result,
        "status": lambda r: r.status,
        "reasons": lambda r: r.reasons,
        "refs": lambda r: r.refs,
        "component": lambda r: r.component("U1").images[0].pixels,
        "pictures": lambda r: list(r.pictures("U1")),
        "region": lambda r: r.region((0, 0, 1, 1)),
        "frame": lambda r: r.frame(0, 1),
        "merged": lambda r: r.merged("U1")[-1].radiance,
        "mosaics": lambda r: r.mosaics(),
        "save_mosaic": lambda r: r.save_mosaic("all", folder / "board.tif"),
        "heights": lambda r: r.heights(),
        "clamped": lambda r: r.clamped({"FID1": (1.0, 2.0)}, sigma=0.01),
        "parts": lambda r: r.parts(),
        "part": lambda r: r.part("U1"),
        "keep_as_good": lambda r: r.keep_as_good(),
        "remove_from_good": lambda r: r.remove_from_good(),
        "timeline": lambda r: r.timeline(),
        "identity": lambda r: r.identity(),
        "report_next_machine": lambda r: r.report_next_machine("SN-1"),
        "decide": lambda r: r.decide("use", "J. Doe", "glare on U3 only"),
        "pin": lambda r: r.pin(),
        "unpin": lambda r: r.unpin(),
        "hold": lambda r: r.hold("tester"),
        "end_hold": lambda r: r.end_hold("tester"),
        "release": lambda r: r.release(),
        "check_board_type": lambda r: r.check_board_type(),
        "board_check_picture": lambda r: r.board_check_picture(),
        "correct_board_type": lambda r: r.correct_board_type("demo"),
    }
    of_board_types: dict[str, Callable[[Any], Any]] = {
        "list": lambda b: b.list(),
        "deleted": lambda b: b.deleted(),
        "get": lambda b: b.get("demo"),
        "get_tagged": lambda b: b.get_tagged("demo"),
        "put": lambda b: b.put(board, tag='"1"'),
        "delete": lambda b: b.delete("demo", tag='"1"'),
        "set_state": lambda b: b.set_state("demo", "approved"),
        "set_limits": lambda b: (b.set_limits("demo", {}), b.set_limits("demo", {}, store=False)),
        "versions": lambda b: b.versions("demo"),
        "version": lambda b: b.version("demo", "latest"),
        "restore": lambda b: b.restore("demo"),
        "reference": lambda b: b.reference("demo"),
        "teach": lambda b: b.teach("demo", "r1"),
        "forget_reference": lambda b: b.forget_reference("demo"),
        "method": lambda b: b.method("demo"),
        "set_method": lambda b: b.set_method("demo", "auto"),
        "forget_method": lambda b: b.forget_method("demo"),
    }
    of_import: dict[str, Callable[[Any], Any]] = {
        "document": lambda i: i.document,
        "upload": lambda _: None,  # called by the station
        "picture": lambda i: i.picture,
        "correct": lambda i: i.correct(side="bottom"),
        "board_type": lambda i: i.board_type(),
        "confirm": lambda i: i.confirm(),
        "discard": lambda i: i.discard(),
    }
    return {
        vaoi.Station: of_station,
        vaoi.StationRun: of_run,
        vaoi.StationBoardTypes: of_board_types,
        vaoi.StationImport: of_import,
    }


def test_every_operation_has_a_method_or_a_reason_and_every_command_a_key_of_its_own(
    address: str, tmp_path: Path
) -> None:
    station = vaoi.connect(address)
    calls = _calls(station, tmp_path)
    file = tmp_path / "board.csv"
    of = {
        vaoi.Station: station,
        vaoi.StationRun: station.run("r1"),
        vaoi.StationBoardTypes: station.board_types,
        vaoi.StationImport: station.upload_board_data(file),
    }
    Examples.asked.clear()
    for kind, methods in calls.items():
        public = {name for name in (*vars(kind), *vars(of[kind])) if not name.startswith("_")}
        assert methods.keys() == public, kind
        for call in methods.values():
            call(of[kind])
    operations = {operation for _, _, operation in OPERATIONS}
    missing = operations - Examples.asked.keys()
    assert missing == LEFT_OUT.keys(), "give a new operation a method in vaoi_station/library, or a reason in LEFT_OUT"
    assert (tmp_path / "board.tif").read_bytes() == CONTENTS["download_mosaic"]
    takes_key = {
        item["operationId"]
        for path in DOCUMENT["paths"].values()
        for item in path.values()
        if any(p.get("name") == "Idempotency-Key" for p in item.get("parameters", ()))
    }
    sent = [headers.get("Idempotency-Key", "") for o, headers in Examples.asked.items() if o in takes_key]
    assert len(sent) == len(set(sent)) > 10
    assert all(re.fullmatch(r'"[0-9a-f]{32}"', key) for key in sent)


@pytest.mark.parametrize(
    ("blocking", "asynchronous"),
    [
        (vaoi.Station, vaoi.AsyncStation),
        (vaoi.StationRun, vaoi.AsyncStationRun),
        (vaoi.StationBoardTypes, vaoi.AsyncBoardTypes),
    ],
    ids=["station", "run", "board types"],
)
def test_programs_with_asyncio_have_the_same_methods(blocking: type, asynchronous: type) -> None:
    def parameters(kind: type) -> dict[str, list[str]]:
        methods = {n: m for n, m in vars(kind).items() if inspect.isfunction(m) and not n.startswith("_")}
        return {name: [str(p) for p in inspect.signature(m).parameters.values()] for name, m in methods.items()}

    others = parameters(asynchronous)
    assert {name: others.get(name) for name in parameters(blocking)} == parameters(blocking)
