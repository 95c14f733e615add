"""The messages of IPC-HERMES-9852 1.6: their attributes, read from XML and written to it.

| channel | from the machine that has the board | from the machine that gets it | both |
|---|---|---|---|
| horizontal | BoardAvailable, RevokeBoardAvailable, TransportFinished, BoardForecast, SendBoardInfo | MachineReady, RevokeMachineReady, StartTransport, StopTransport, QueryBoardInfo | ServiceDescription, CheckAlive, Notification, Command |

Attributes that are not in the table are ignored, as the standard says. What travels on keeps the text in which it came.
"""  # noqa: E501  a table

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from types import MappingProxyType
from typing import NamedTuple
from xml.etree import ElementTree

from vaoi_station.errors import InputError

VERSION = "1.6"
MOST_BYTES = 65_536
"""Longest message of the standard, bytes."""
_MOST_TEXT = 1000
"""Longest value of an attribute that is kept; the standard limits the message only."""
_NUMBER = re.compile(r"[+]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)

Parts = Mapping[str, tuple[tuple[str, Mapping[str, str]], ...]]
"""Inner elements by the name of their list: name and attributes of each."""
_NOTHING: Mapping[str, str] = MappingProxyType({})
_NO_PARTS: Parts = MappingProxyType({})


class ProtocolError(Exception):
    """A neighbour sent what the standard does not allow; the connection is ended with this text."""


class _Kind(NamedTuple):
    """What the values of an attribute may be."""

    allows: Callable[[str], bool]
    limit: str


def _is_whole(low: int, high: int, text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) <= 10 and low <= int(text) <= high


def _whole(low: int, high: int) -> _Kind:
    return _Kind(partial(_is_whole, low, high), f"a whole number from {low} to {high}")


_TEXT = _Kind(lambda text: len(text) <= _MOST_TEXT, f"a text of at most {_MOST_TEXT} characters")
_NAME = _Kind(lambda text: 0 < len(text.strip()) <= _MOST_TEXT, "a text that is not empty")
_POSITIVE = _Kind(lambda text: bool(_NUMBER.fullmatch(text)) and 0 < float(text) < 1e9, "a number above 0")
_NOT_NEGATIVE = _Kind(lambda text: bool(_NUMBER.fullmatch(text)) and float(text) < 1e9, "a number, 0 or more")
_WORD = _whole(0, 65_535)

_KINDS: dict[str, _Kind] = {
    "BoardId": _NAME,
    "MachineId": _NAME,
    "Version": _Kind(lambda text: bool(re.fullmatch(r"[1-9][0-9]{0,2}[.][0-9]{1,3}", text)), "a version such as 1.6"),
    "LaneId": _whole(1, 65_535),
    "UpstreamLaneId": _WORD,
    "DownstreamLaneId": _WORD,
    "FailedBoard": _whole(0, 2),
    "FlippedBoard": _whole(0, 2),
    "TransferState": _whole(1, 3),
    "BoardTransfer": _whole(1, 3),
    "NotificationCode": _whole(0, 65_535),
    "Severity": _whole(1, 4),
    "Type": _whole(1, 2),
    "Command": _WORD,
    "Route": _WORD,
    "Action": _WORD,
    "SupervisorySystemPort": _WORD,
    **dict.fromkeys(("Length", "Width", "Thickness", "ConveyorSpeed", "Weight"), _POSITIVE),
    **dict.fromkeys(("TopClearanceHeight", "BottomClearanceHeight", "TimeUntilAvailable"), _NOT_NEGATIVE),
}
"""Attributes whose values are limited; all others are texts. Lengths are mm, speeds mm/s, weights g."""

_BOARD = (
    "ProductTypeId TopBarcode BottomBarcode Length Width Thickness ConveyorSpeed TopClearanceHeight "
    "BottomClearanceHeight Weight WorkOrderId BatchId"
)
_ROUTED = f"{_BOARD} Route Action"
_SURE = "BoardId BoardIdCreatedBy FailedBoard FlippedBoard"
_FORECAST = "ForecastId TimeUntilAvailable BoardId BoardIdCreatedBy"
_TRACKED = f"MachineId BoardTransfer {_SURE}"
_MAGAZINE = "MagazineId SlotId"

MESSAGES: Mapping[str, tuple[frozenset[str], frozenset[str]]] = {
    tag: (frozenset(must.split()), frozenset(may.split()))
    for tag, must, may in (
        ("ServiceDescription", "MachineId LaneId Version", "InterfaceId"),
        ("CheckAlive", "", "Type Id"),
        ("Notification", "NotificationCode Severity", "Description"),
        ("Command", "Command", ""),
        ("BoardForecast", "FailedBoard FlippedBoard", f"{_FORECAST} {_BOARD}"),
        ("BoardAvailable", _SURE, _ROUTED),
        ("RevokeBoardAvailable", "", ""),
        ("MachineReady", "FailedBoard", f"ForecastId BoardId FlippedBoard {_BOARD}"),
        ("RevokeMachineReady", "", ""),
        ("StartTransport", "BoardId", "ConveyorSpeed"),
        ("StopTransport", "TransferState BoardId", ""),
        ("TransportFinished", "TransferState BoardId", ""),
        ("QueryBoardInfo", "", "TopBarcode BottomBarcode"),
        ("SendBoardInfo", "", f"{_SURE} {_ROUTED}"),
        ("SupervisoryServiceDescription", "SystemId Version", ""),
        ("BoardArrived", f"{_TRACKED} UpstreamLaneId", f"UpstreamInterfaceId {_MAGAZINE} {_ROUTED}"),
        ("BoardDeparted", f"{_TRACKED} DownstreamLaneId", f"DownstreamInterfaceId {_MAGAZINE} {_ROUTED}"),
        ("QueryHermesCapabilities", "", ""),
        ("SendHermesCapabilities", "", ""),
        ("SendWorkOrderInfo", "", f"QueryId {_SURE} {_ROUTED}"),
        ("GetConfiguration", "", ""),
        ("SetConfiguration", "", "MachineId SupervisorySystemPort"),
        ("CurrentConfiguration", "", "MachineId SupervisorySystemPort"),
    )
}  # fmt: skip
"""Every message that the station knows, with the attributes that it must and may have."""

BOARD_FIELDS = tuple(f"{_SURE} {_ROUTED}".split())
"""The attributes of a board that travel on from machine to machine."""


def listed(name: str, tags: Iterable[str]) -> Parts:
    """Return the inner elements of a list of names, such as SupportedFeatures."""
    return {name: tuple((tag, _NOTHING) for tag in tags)}


@dataclass(frozen=True)
class Message:
    """One message; the values are the texts of its attributes."""

    tag: str
    values: Mapping[str, str] = field(default_factory=dict)
    parts: Parts = field(default_factory=dict)
    timestamp: str = field(default="", compare=False)
    left_out: tuple[str, ...] = field(default=(), compare=False)
    """What is wrong with optional attributes, which were left out."""

    @classmethod
    def of(cls, tag: str, parts: Parts = _NO_PARTS, **values: str | int | None) -> Message:
        """Return a message with these attributes; None stands for one that is absent."""
        return cls(tag, {name: str(value) for name, value in values.items() if value is not None}, parts)

    def get(self, name: str) -> str | None:
        """Return the text of an attribute; None if it is absent."""
        return self.values.get(name)

    def board(self) -> dict[str, str]:
        """Return the attributes that travel on with the board."""
        return {name: self.values[name] for name in BOARD_FIELDS if name in self.values}

    def to_bytes(self) -> bytes:
        """Return the message as XML. Sub-boards are left out if the message would be too long with them."""
        stamp = self.timestamp or datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        root = ElementTree.Element("Hermes", Timestamp=stamp)
        body = ElementTree.SubElement(root, self.tag, dict(self.values))
        for name, entries in self.parts.items():
            inner = ElementTree.SubElement(body, name)
            for tag, values in entries:
                ElementTree.SubElement(inner, tag, dict(values))
        data: bytes = ElementTree.tostring(root, encoding="utf-8")
        if len(data) > MOST_BYTES and "SubBoards" in self.parts:
            return Message(self.tag, self.values, {}, stamp).to_bytes()
        return data

    def __str__(self) -> str:
        values = " ".join(f"{name}={value}" for name, value in self.values.items())
        return f"{self.tag} {values}".strip()


def read_message(data: bytes) -> Message | None:
    """Read one message; None if its name is not known, because such messages are ignored.

    Raises:
        ProtocolError: this is no message of the standard, or an attribute that it must have is absent or wrong.
    """
    if b"<!" in data or b"<?" in data:
        raise ProtocolError("the message has a comment, an entity or an instruction, which the standard does not know")
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise ProtocolError(f"the message is no XML: {error}") from None
    if root.tag != "Hermes" or len(root) != 1:
        raise ProtocolError(f"the message has {len(root)} elements in {root.tag[:40]!r}, but must have 1 in 'Hermes'")
    body = root[0]
    if body.tag not in MESSAGES:
        return None
    must, may = MESSAGES[body.tag]
    values, left_out = {}, []
    for name in (*sorted(must), *sorted(may)):
        text = body.get(name)
        kind = _KINDS.get(name, _TEXT)
        if text is not None and kind.allows(text):
            values[name] = text
        elif name in must:
            what = "is absent" if text is None else f"is {text[:40]!r}, but must be {kind.limit}"
            raise ProtocolError(f"{body.tag}: {name} {what}")
        elif text:
            left_out.append(f"{name} is {text[:40]!r}, but must be {kind.limit}")
    parts = {inner.tag: tuple((e.tag, dict(e.attrib)) for e in inner) for inner in body}
    return Message(body.tag, values, parts, (root.get("Timestamp") or "")[:_MOST_TEXT], tuple(left_out))


def message_of_text(text: str) -> Message:
    """Return the message of a text such as `BoardAvailable:ProductTypeId=P1,FailedBoard=2`.

    InputError: it is none.
    """
    tag, _, rest = text.partition(":")
    if tag not in MESSAGES:
        raise InputError.field("line send", "message", tag, f"one of {', '.join(MESSAGES)}")
    must, may = MESSAGES[tag]
    values = {}
    for pair in filter(None, rest.split(",")):
        name, equals, value = pair.partition("=")
        if not equals or name not in must | may:
            raise InputError.field(
                f"line send: {tag}", "attribute", pair, f"NAME=VALUE with {', '.join(sorted(must | may))}"
            )
        if not (kind := _KINDS.get(name, _TEXT)).allows(value):
            raise InputError.field(f"line send: {tag}", name, value, kind.limit)
        values[name] = value
    return Message(tag, values)
