"""The pictures of many components, read from one streamed answer of a station."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from vaoi_station.demo.client import unusable_reply
from vaoi_station.errors import DeviceError, GoneError

_MOST_HEAD = 10_000


@dataclass(frozen=True, eq=False)
class ComponentPictures:
    """The pictures of one component of a batch, best first."""

    address: str
    """Address of the component, or `region`."""
    views: tuple[Mapping[str, Any], ...]
    """Figures and matrices of each picture, with the fields of the component's list of views."""
    pixels: tuple[NDArray[Any], ...]
    """(h, w) or (h, w, 3) of each picture, 8 or 16 bit; colours are red, green, blue."""
    refused: str | None = None
    """Why the component has no pictures; None if it was not refused."""


def read_pictures(reply: BinaryIO, url: str) -> Iterator[ComponentPictures]:
    """Yield the components of a multipart answer with bare pixels, each when all its pictures have arrived.

    Args:
        reply: the body of the answer.
        url: its address, for messages.

    Raises:
        GoneError: the station no longer keeps the frames of the run; the components so far are right.
        DeviceError: the answer ended early, the station had a fault, or the bytes are no such answer.
    """
    begun: dict[str, tuple[dict[str, Any], list[NDArray[Any]]]] = {}
    end: dict[str, Any] | None = None
    try:
        for name, content in _files(reply):
            folder, _, file = name.rpartition("/")
            if file == "views.json":
                begun[folder] = json.loads(content), []
            elif file == "end.json":
                end = json.loads(content)
                if not end["complete"]:
                    error = end["error"]
                    kind = GoneError if error["code"] in (GoneError.code, "frames-gone") else DeviceError
                    raise kind(f"{url}: {error['message']}", action=error["action"], code=error["code"])
            elif file != "run.json":
                document, pixels = begun[folder]
                view = document["views"][len(pixels)]
                shape = (view["height_px"], view["width_px"], view["channels"])[: 2 if view["channels"] == 1 else 3]
                pixels.append(np.frombuffer(content, np.dtype(view["dtype"])).reshape(shape))
            document, pixels = begun.get(folder, ({}, []))
            if document and len(pixels) == len(document["views"]):
                del begun[folder]
                refused = document["refused"]["message"] if document.get("refused") else None
                yield ComponentPictures(document["address"], tuple(document["views"]), tuple(pixels), refused)
    except EOFError:
        end = None
    except (ValueError, KeyError, IndexError, TypeError) as error:
        raise unusable_reply(url, f"a batch that cannot be read ({type(error).__name__}: {error})") from error
    if end is None or begun:
        raise unusable_reply(url, "a batch that ends early")


def _files(reply: BinaryIO) -> Iterator[tuple[str, bytes]]:
    """Yield name and content of each part; raise EOFError if the answer ends before its last boundary."""
    boundary = line = reply.readline(_MOST_HEAD).strip()
    while line == boundary and boundary.startswith(b"--"):
        headers = {}
        while header := reply.readline(_MOST_HEAD).strip():
            key, _, value = header.decode("ascii").partition(": ")
            headers[key.lower()] = value
        content = reply.read(int(headers["content-length"]))
        if len(content) < int(headers["content-length"]):
            raise EOFError
        yield headers["content-disposition"].partition('filename="')[2].rstrip('"'), content
        reply.readline(_MOST_HEAD)
        line = reply.readline(_MOST_HEAD).strip()
    if line != boundary + b"--":
        raise EOFError
