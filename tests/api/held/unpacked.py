"""Reading the files of a batch in every container."""

from __future__ import annotations

import email
import io
import json
import zipfile
from collections.abc import Iterator
from typing import Any

from vaoi_station.runs.batches.containers import BOUNDARY


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
