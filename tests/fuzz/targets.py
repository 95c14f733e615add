"""The parsers of everything that comes from outside, each as a function of bytes.

A target ends in order or raises a `VaoiError`. Any other exception is a find.
"""

from __future__ import annotations

import atexit
import gzip
import io
import json
import shutil
import tarfile
import tempfile
from collections.abc import Callable
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from fastapi.testclient import TestClient

from tests.api.held.setup_files import setup_files
from tests.api.held_station import HeldStation
from tests.fuzz import station_targets
from tests.fuzz.board_targets import board_archive, board_data, import_options, odb_design, unix_compressed
from vaoi_station.acquisition.controller.protocol import PAYLOAD_LONGEST, FrameReader, Link, Message, encode
from vaoi_station.api.app import create_app
from vaoi_station.config import read_config
from vaoi_station.files import read_board_type, read_calibration
from vaoi_station.files.access_keys import KeyFile
from vaoi_station.files.calibrations import read_layout
from vaoi_station.files.images import encode_png
from vaoi_station.files.recordings import open_recording
from vaoi_station.files.results import read_stitch
from vaoi_station.simulation import read_scenario
from vaoi_station.transfer.package import MANIFEST
from vaoi_station.transfer.runs import import_run

GOLDEN = Path(__file__).parents[1] / "api" / "openapi.json"
Target = Callable[[bytes, Path], object]


def controller(data: bytes, folder: Path) -> None:
    """Feed bytes to the link with the controller: frames with a right checksum around pieces of the data, and noise."""
    link, now_s = Link(), 0.0
    link.outgoing(now_s)
    for piece in data.split(b"\n"):
        now_s += 0.01
        # Noise hardly ever has a right checksum, so that the messages behind it would never be read.
        framed = encode(Message(piece[0], piece[1], piece[2 : 2 + PAYLOAD_LONGEST])) if len(piece) > 1 else piece
        link.receive(framed, now_s)
        link.receive(piece, now_s)
        FrameReader().feed(piece + framed)
        link.outgoing(now_s)


@cache
def _frame() -> bytes:
    return encode_png(np.zeros((16, 16), np.uint8), 3)


def _file(name: str, read: Callable[[Path], object]) -> Target:
    def run(data: bytes, folder: Path) -> None:
        path = folder / name
        path.write_bytes(data)
        read(path)

    return run


def recording(data: bytes, folder: Path) -> None:
    """Open a recording with this recording.json, and read a frame that may be there."""
    (folder / "recording.json").write_bytes(data)
    (folder / "frames").mkdir()
    for camera, row in product(range(2), range(2)):
        (folder / "frames" / f"c{camera:02d}_r{row:03d}.png").write_bytes(_frame())
    open_recording(folder).frame(0, 0)


def package(data: bytes, folder: Path) -> None:
    """Import a package: the raw bytes; or, if they are JSON, one with this manifest and this run.json."""
    path = folder / "run.vaoi"
    try:
        given = json.loads(data)
        members = {MANIFEST: given["manifest"], "run.json": given["run"]} if isinstance(given, dict) else {}
        content = io.BytesIO()
        with tarfile.open(fileobj=content, mode="w:gz", compresslevel=1) as tar:
            for name, document in members.items():
                text = json.dumps(document).encode()
                member = tarfile.TarInfo(name)
                member.size = len(text)
                tar.addfile(member, io.BytesIO(text))
        path.write_bytes(content.getvalue())
    except (ValueError, KeyError, RecursionError):
        # The bytes are those of the archive, compressed here: a wrong checksum of gzip would hide all behind it.
        path.write_bytes(data if data[:2] == b"\x1f\x8b" else gzip.compress(data, 1))
    import_run(path, folder / "imported")


@cache
def _client() -> TestClient:
    station = HeldStation()
    station.film()
    folder = tempfile.mkdtemp(prefix="vaoi-fuzz-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    app = create_app(station, ["testserver"], files=setup_files(Path(folder)))
    return TestClient(app, raise_server_exceptions=False)


@cache
def operations() -> tuple[tuple[str, str], ...]:
    """Return (method, path) of all operations of the OpenAPI document that take a body."""
    paths: dict[str, dict[str, Any]] = json.loads(GOLDEN.read_text(encoding="utf-8"))["paths"]
    found = [(m, path) for path, methods in paths.items() for m, o in methods.items() if "requestBody" in o]
    return tuple(sorted(found))


def operation_of(data: bytes) -> tuple[str, str, bytes]:
    """Return method, path and body of an input: its first line names them, or its first byte chooses."""
    # Names stay right when operations are added; a fuzzer reaches others by damaging them.
    line, _, body = data.partition(b"\n")
    named = tuple(line.decode("latin-1").split(" "))
    if named in operations():
        return named[0], named[1], body
    method, path = operations()[data[0] % len(operations())]
    return method, path, data[1:]


def rest(data: bytes, folder: Path) -> None:
    """Send a body to an operation; the name in its path is `small`."""
    if not data:
        return
    method, path, body = operation_of(data)
    for name in ("{name}", "{run}", "{ref}", "{board_type}"):
        path = path.replace(name, "small")
    # The settings ask for a condition; what they write is in the folder of the client.
    headers = {"Content-Type": "application/json", "If-Match": "*"} if path.endswith("/settings") else {}
    answer = _client().request(method, path, content=body, headers=headers)
    if answer.status_code == 500:
        raise AssertionError(f"{method} {path}: {answer.text}")


def query(data: bytes, folder: Path) -> None:
    """Send bytes as parameters and names of requests."""
    text = data.decode("latin-1")
    client = _client()
    for path in ("/runs", "/runs/latest", f"/runs/{quote(text[:80])}", "/runs/next"):
        values = {"limit": text, "before": text, "after": text, "timeout": "0"}
        answer = client.get(f"/api/v1{path}", params=values)
        assert answer.status_code != 500, f"{path}: {answer.text}"


TARGETS: dict[str, Target] = {
    "controller": controller,
    "station": _file("station.toml", read_config),
    "scenario": _file("scenario.toml", read_scenario),
    "board": _file("board.json", read_board_type),
    "board-data": board_data,
    "board-archive": board_archive,
    "board-options": import_options,
    "odb-design": odb_design,
    "unix-compress": unix_compressed,
    "calibration": _file("calibration.json", read_calibration),
    "layout": _file("layout.json", read_layout),
    "result": _file("result.json", read_stitch),
    "keys": _file("keys.json", lambda path: KeyFile(path).entries()),
    "recording": recording,
    "package": package,
    "backup": station_targets.backup,
    "history": station_targets.history,
    "database": station_targets.database,
    "gvcp": station_targets.gvcp_reply,
    "push-state": station_targets.push_state,
    "ring": station_targets.ring,
    "rest": rest,
    "query": query,
}


def run_target(name: str, data: bytes) -> None:
    """Run a target in an empty folder of its own."""
    # In memory if that is possible: a fuzzer writes thousands of files a minute.
    place = "/dev/shm" if Path("/dev/shm").is_dir() else None
    with tempfile.TemporaryDirectory(dir=place) as folder:
        TARGETS[name](data, Path(folder))
