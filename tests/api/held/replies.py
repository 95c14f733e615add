"""Reading pictures and batches from replies, by means of other libraries."""

from __future__ import annotations

import email
import io
import json
import zipfile
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np

from vaoi_station.runs.batches.containers import BOUNDARY

RUNS = "/api/v1/runs"


def picture(answer: Any) -> np.ndarray:
    """Return the pixels of a reply in any format."""
    kind = answer.headers["content-type"]
    if kind == "application/octet-stream":
        size = [int(answer.headers[f"x-image-{n}"]) for n in ("height", "width")]
        return np.frombuffer(answer.content, answer.headers["x-image-dtype"]).reshape(size)
    if kind == "application/x-npy":
        return np.asarray(np.load(io.BytesIO(answer.content)))
    return np.asarray(cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_UNCHANGED))


def unpacked(content: bytes, container: str) -> dict[str, bytes]:
    """Return the files of a batch by their names, in their order, read by Python's own modules."""
    if container == "multipart":
        return dict(_parts(content))
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert archive.testzip() is None
        return {name: archive.read(name) for name in archive.namelist()}


def documents(files: dict[str, bytes]) -> dict[str, Any]:
    """Return the JSON documents among the files."""
    return {name: json.loads(content) for name, content in files.items() if name.endswith(".json")}


def _parts(content: bytes) -> Iterator[tuple[str, bytes]]:
    """Read a multipart answer as a program without a library does: line by line, and bodies by their length."""
    stream, line = io.BytesIO(content), f"--{BOUNDARY}"
    while (found := stream.readline()) == f"{line}\r\n".encode():
        head = b""
        while (header := stream.readline()) != b"\r\n":
            head += header
        part = email.message_from_bytes(head)
        name = part.get_filename()
        assert name is not None
        yield name, stream.read(int(part["Content-Length"]))
        assert stream.readline() == b"\r\n"
    assert found == f"{line}--\r\n".encode()
