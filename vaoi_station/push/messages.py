"""Messages: what receivers get of an event, and which events they want."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from typing import Any, NamedTuple

from vaoi_station.runs.states.schemas import EventRecord

OWN_KIND = "push"
"""Kind of the events about receivers. They are not pushed: a receiver that fails would cause messages without end."""


class Message(NamedTuple):
    """One event as it is sent. Every attempt sends the same id and the same bytes."""

    id: str
    type: str
    body: bytes
    record: EventRecord


def type_of(record: EventRecord) -> str:
    """Return the type of an event: its kind, and its state if it has one, as in `run.ready`."""
    return ".".join(part.replace("-", "_") for part in (record.kind, record.state) if part)


def message_of(record: EventRecord, station: str) -> Message:
    """Return the message of an event of the station with this name."""
    # A number alone can be given twice: a power cut or a restored backup may take the newest events away.
    origin = f"{station}\n{record.model_dump_json()}"
    name = f"evt_{record.number}_{hashlib.sha256(origin.encode()).hexdigest()[:16]}"
    data: dict[str, Any] = {"station": station, **record.model_dump(mode="json", exclude_none=True)}
    kind = type_of(record)
    body = {"type": kind, "timestamp": record.time, "data": data}
    return Message(name, kind, json.dumps(body, separators=(",", ":")).encode(), record)


def is_wanted(record: EventRecord, types: Sequence[str]) -> bool:
    """Return whether a receiver of these types gets an event; no types stand for all."""
    if record.kind == OWN_KIND:
        return False
    found = type_of(record)
    names = [name.replace("-", "_") for name in types]
    return not names or any(found == name or found.startswith(f"{name}.") for name in names)
