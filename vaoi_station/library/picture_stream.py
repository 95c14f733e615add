"""The pictures of many components, read from one streamed answer of a station."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from vaoi_station.demo.client import unusable_reply
from vaoi_station.errors import DeviceError, GoneError

_MOST_HEAD = 10_000


class Readable(Protocol):
    """A reply whose body is read piece by piece."""

    def read(self, size: int, /) -> bytes:
        """Return at most `size` bytes; none at the end."""
        ...

    def readline(self, limit: int, /) -> bytes:
        """Return the bytes up to the next line feed, at most `limit`."""
        ...


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


@dataclass
class _Begun:
    """A component whose pictures have not all arrived."""

    document: dict[str, Any]
    pixels: list[NDArray[Any]] = field(default_factory=list)

    @property
    def complete(self) -> bool:
        return len(self.pixels) == len(self.document["views"])

    def finished(self) -> ComponentPictures:
        refused = self.document.get("refused")
        return ComponentPictures(
            self.document["address"],
            tuple(self.document["views"]),
            tuple(self.pixels),
            None if refused is None else refused["message"],
        )


def read_pictures(reply: Readable, url: str) -> Iterator[ComponentPictures]:
    """Yield the components of a multipart answer with bare pixels, each when all its pictures have arrived.

    Args:
        reply: the body of the answer.
        url: its address, for messages.

    Raises:
        GoneError: the station no longer keeps the frames of the run; the components so far are right.
        DeviceError: the answer ended early, the station had a fault, or the bytes are no such answer.
    """
    begun: dict[str, _Begun] = {}
    ended = False
    try:
        for name, content in _files(reply, url):
            folder, _, file = name.rpartition("/")
            if file == "views.json":
                begun[folder] = _Begun(json.loads(content))
            elif file == "end.json":
                _check_end(json.loads(content), url)
                ended = True
            elif file != "run.json":
                component = begun[folder]
                component.pixels.append(_pixels(content, component.document["views"][len(component.pixels)]))
            if folder in begun and begun[folder].complete:
                yield begun.pop(folder).finished()
    except (ValueError, KeyError, IndexError, TypeError) as error:
        raise unusable_reply(url, f"a batch that cannot be read ({type(error).__name__}: {error})") from error
    if not ended or begun:
        raise unusable_reply(url, "a batch that ends early")


def _files(reply: Readable, url: str) -> Iterator[tuple[str, bytes]]:
    """Yield name and content of each part."""
    boundary = reply.readline(_MOST_HEAD).strip()
    line = boundary
    while line == boundary and boundary.startswith(b"--"):
        headers = {}
        while header := reply.readline(_MOST_HEAD).strip():
            key, _, value = header.decode("ascii").partition(": ")
            headers[key.lower()] = value
        size = int(headers["content-length"])
        yield headers["content-disposition"].partition('filename="')[2].rstrip('"'), _exactly(reply, size, url)
        reply.readline(_MOST_HEAD)
        line = reply.readline(_MOST_HEAD).strip()
    if line != boundary + b"--":
        raise unusable_reply(url, "a batch that ends early")


def _exactly(reply: Readable, size: int, url: str) -> bytes:
    pieces, missing = [], size
    while missing:
        piece = reply.read(missing)
        if not piece:
            raise unusable_reply(url, "a batch that ends early")
        pieces.append(piece)
        missing -= len(piece)
    return b"".join(pieces)


def _pixels(content: bytes, view: Mapping[str, Any]) -> NDArray[Any]:
    channels = int(view["channels"])
    shape = (view["height_px"], view["width_px"]) + ((channels,) if channels > 1 else ())
    return np.frombuffer(content, np.dtype(view["dtype"])).reshape(shape)


def _check_end(end: Mapping[str, Any], url: str) -> None:
    if end["complete"]:
        return
    error = end["error"]
    kind = GoneError if error["code"] in (GoneError.code, "frames-gone") else DeviceError
    raise kind(f"{url}: {error['message']}", action=error["action"], code=error["code"])
