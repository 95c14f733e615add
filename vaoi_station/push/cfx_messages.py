"""The messages of IPC-CFX (IPC-2591) 2.1: which one an event of the station becomes, and the answers to requests.

Names of properties and values are those of the classes in IPCConnectedFactoryExchange/CFX 2.1.1. `SOURCES` names the
file of each message; structures that they contain are below CFX/Structures (Fault.cs, InspectedUnit.cs, Inspection.cs,
NumericMeasurement.cs, Endpoint.cs). Its library takes an enumeration that is absent as its first value, so results are
always written: "Skipped", the only value that contains no judgement.
"""

from __future__ import annotations

import json
import platform
import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any, NamedTuple

from vaoi_station.errors import GoneError, NotFoundError
from vaoi_station.model import Reason
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import EventRecord, RunDetail, StationSnapshot
from vaoi_station.runs.states.tables import StationState
from vaoi_station.version import __version__

VERSION = "2.1"
FAULT = "fault"
"""Kind of the events about conditions that begin and end, which `FaultWatch` adds to the log."""
KINDS = ("station", "run", "parts", FAULT)
"""Kinds of events that become messages."""
_STATION = "CFX.ResourcePerformance"
_WORK = "CFX.Production"
SOURCES = {
    "CFX.EndpointConnected": "CFX/EndpointConnected.cs",
    "CFX.EndpointShuttingDown": "CFX/EndpointShuttingDown.cs",
    "CFX.Heartbeat": "CFX/Heartbeat.cs",
    "CFX.WhoIsThereResponse": "CFX/WhoIsThereResponse.cs",
    "CFX.AreYouThereResponse": "CFX/AreYouThereResponse.cs",
    "CFX.GetEndpointInformationResponse": "CFX/GetEndpointInformationResponse.cs",
    "CFX.NotSupportedResponse": "CFX/NotSupportedResponse.cs",
    f"{_STATION}.StationOnline": "CFX/ResourcePerformance/StationOnline.cs",
    f"{_STATION}.StationOffline": "CFX/ResourcePerformance/StationOffline.cs",
    f"{_STATION}.StationStateChanged": "CFX/ResourcePerformance/StationStateChanged.cs",
    f"{_STATION}.FaultOccurred": "CFX/ResourcePerformance/FaultOccurred.cs",
    f"{_STATION}.FaultCleared": "CFX/ResourcePerformance/FaultCleared.cs",
    f"{_WORK}.RecipeActivated": "CFX/Production/RecipeActivated.cs",
    f"{_WORK}.UnitsArrived": "CFX/Production/UnitsArrived.cs",
    f"{_WORK}.UnitsDeparted": "CFX/Production/UnitsDeparted.cs",
    f"{_WORK}.WorkStarted": "CFX/Production/WorkStarted.cs",
    f"{_WORK}.WorkCompleted": "CFX/Production/WorkCompleted.cs",
    f"{_WORK}.TestAndInspection.UnitsInspected": "CFX/Production/TestAndInspection/UnitsInspected.cs",
}
"""Every message that the station sends, and its class."""
STATES: dict[str, str] = {
    StationState.STARTING: "6500",
    StationState.IDLE: "2000",
    StationState.ARMING: "2000",
    StationState.ARMED: "2200",
    StationState.FILMING: "1100",
    StationState.BLOCKED: "2201",
    StationState.FAULTED: "5000",
    StationState.STOPPING: "6500",
}
"""States of SEMI E10 by those of the station (CFX/Structures/ResourceState.cs)."""
_WORK_RESULTS = {"ready": "Completed", "degraded": "Failed", "failed": "Aborted"}
"""CFX/Structures/WorkResult.cs: `Failed` is work that was completed with an undesirable result."""
_NOT_JUDGED = "Measured, not judged."
_UNITS = {"px": "px", "mm": "mm", "deg": "deg", "ms": "ms", "s": "mm/s", "percent": "%"}
"""Units by the last part of a figure's name; the only one that ends with `_s` is a speed."""
_MEASURES = ("presence", "dx_mm", "dy_mm", "sigma_mm", "turn_deg", "sigma_deg", "alike", "height_mm")
"""Numbers of a part in the document of all parts."""
_NAMESPACE = uuid.UUID("6f0f7f0e-5f3c-5e0b-9d43-1c8f7c1b2a67")
_LONGEST = 1024
"""Longest description of a fault."""


class Message(NamedTuple):
    """One message, and the time of what it tells."""

    name: str
    id: str
    time: str
    body: Mapping[str, Any]
    target: str | None = None
    request: str | None = None

    def envelope(self, handle: str) -> dict[str, Any]:
        """Return the document (CFX/CFXEnvelope.cs) of an endpoint."""
        return {
            "MessageName": self.name,
            "Version": VERSION,
            "TimeStamp": self.time,
            "UniqueID": self.id,
            "Source": handle,
            "Target": self.target,
            "RequestID": self.request,
            "MessageBody": {"$type": f"{self.name}, CFX", **self.body},
        }


@dataclass
class History:
    """What earlier events tell about a later one."""

    first: int = 0
    """Number from which on the events are those of this start of the station."""
    station: EventRecord | None = None
    """The latest event of the station's state."""
    since: str = ""
    """Time since when the state of CFX, which several of the station share, is what it is."""
    faults: dict[str, EventRecord] = field(default_factory=dict)
    """The event with which each condition that lasts began, by its code."""

    def add(self, records: Iterable[EventRecord]) -> None:
        """Take the next events into account."""
        for record in records:
            if record.kind == "station" and record.state in STATES:
                before, self.station = self.station, record
                if before is None or self.is_start(record, before) or STATES[before.state] != STATES[record.state]:
                    self.since = record.time
            elif record.kind == FAULT and record.state == "over":
                self.faults.pop(record.code, None)
            elif record.kind == FAULT:
                self.faults[record.code] = record

    def is_start(self, record: EventRecord, before: EventRecord | None) -> bool:
        """Return whether an event of the station's state is the first one after a start; `before` is the one before."""
        if before is not None and before.state == StationState.STOPPING:
            return True
        return record.number >= self.first and (before is None or before.number < self.first)


class FaultWatch:
    """Adds an event when a condition of the station begins or ends, with the time of it, for `FaultOccurred`."""

    def __init__(
        self,
        add: Callable[..., EventRecord],
        snapshot: Callable[[], StationSnapshot],
        standing: Mapping[str, EventRecord],
    ) -> None:
        """Prepare; `standing` are the conditions that lasted at the end of the log, by their codes."""
        self._add, self._snapshot, self.standing = add, snapshot, dict(standing)

    def look(self) -> None:
        """Compare the conditions of the station with those before."""
        now = self._snapshot()
        found: dict[str, tuple[str, Reason]] = {}
        for state, reasons in (("warning", now.warnings), ("error", now.reasons)):
            # What concerns the connection itself would cause messages without end.
            found |= {reason.code: (state, reason) for reason in reasons if reason.code != "cfx-lost"}
        for code, (state, reason) in found.items():
            if code not in self.standing:
                self.standing[code] = self._add(FAULT, reason.message, state=state, code=code, action=reason.action)
        for code in self.standing.keys() - found.keys():
            self._add(FAULT, f"It is over: {code}.", state="over", code=code)
            del self.standing[code]


@dataclass(frozen=True)
class Facts:
    """What is asked of the station about its runs. A run may be deleted: GoneError, NotFoundError."""

    snapshot: Callable[[], StationSnapshot]
    run: Callable[[str], RunDetail]
    figures: Callable[[str], Mapping[str, float]]
    """The figures of a finished run."""
    parts: Callable[[str], bytes | None]
    """The document of the measured parts of a run; None without one."""


def identifier(handle: str, *parts: object) -> str:
    """Return an id that is the same whenever the message is made anew, by which a duplicate is recognised."""
    return str(uuid.uuid5(_NAMESPACE, "/".join(map(str, (handle, *parts)))))


class Translator:
    """Turns the events of one station into messages, in the order of the log."""

    def __init__(self, handle: str, facts: Facts, hermes: bool = False) -> None:
        """Prepare; with `hermes`, an id of a board that is a GUID is the BoardId of the machine upstream."""
        self.handle, self._facts, self._hermes = handle, facts, hermes
        self._recipe: tuple[str, str | None] | None = None

    def messages(self, record: EventRecord, history: History) -> list[Message]:
        """Return the messages of an event; `history` is that of the events before. Errors of the facts are raised."""
        bodies: list[tuple[str, dict[str, Any]]] = []
        if record.kind == "station" and record.state in STATES:
            bodies = self._state(record, history)
        elif record.kind == FAULT:
            bodies = self._fault(record, history.faults.get(record.code))
        elif record.run is not None and record.kind == "run":
            bodies = self._run(record, record.run)
        elif record.run is not None and record.kind == "parts" and record.state == "measured":
            measured = self._parts(record, record.run)
            bodies = [self._inspected(record, record.run, "parts", measured)] if measured else []
        return [
            # A restored backup gives numbers anew, so the number does not suffice.
            Message(name, identifier(self.handle, record.number, record.time, name), record.time, body)
            for name, body in bodies
        ]

    def _state(self, record: EventRecord, history: History) -> list[tuple[str, dict[str, Any]]]:
        before = history.station
        started = history.is_start(record, before)
        known = None if before is None else _duration(history.since, record.time)
        ended = before is not None and before.state == StationState.STOPPING
        old = StationState.STARTING if started or before is None else before.state
        change = {
            "OldState": STATES[old],
            "OldStateDuration": None if started else known,
            "NewState": STATES[record.state],
            "RelatedFault": None,
        }
        found: list[tuple[str, dict[str, Any]]] = []
        if started and record.state != StationState.STOPPING:
            found.append((f"{_STATION}.StationOnline", {"OfflineDuration": known if ended else None}))
        if change["OldState"] != change["NewState"]:
            found.append((f"{_STATION}.StationStateChanged", change))
        if record.state == StationState.STOPPING:
            found.append((f"{_STATION}.StationOffline", {}))
        return found

    def _fault(self, record: EventRecord, begun: EventRecord | None) -> list[tuple[str, dict[str, Any]]]:
        if record.state != "over":
            return [(f"{_STATION}.FaultOccurred", {"Fault": fault_of(self.handle, record)})]
        if begun is None:
            return []  # no message has said that it had begun
        occurrence = identifier(self.handle, begun.number, begun.time, FAULT)
        return [(f"{_STATION}.FaultCleared", {"FaultOccurrenceId": occurrence, "Operator": None})]

    def _run(self, record: EventRecord, run: str) -> list[tuple[str, dict[str, Any]]]:
        transaction = identifier(self.handle, run)
        if record.state == "filming":
            detail, found = self._detail(run), list[tuple[str, dict[str, Any]]]()
            units = self._units(run, detail)
            started: dict[str, Any] = {**units, "TransactionID": transaction, "Lane": None}
            if detail is not None:
                made = detail.made_with
                recipe = (detail.board_type, made.board_type_revision if made else None)
                started |= {"RecipeName": recipe[0], "Revision": recipe[1], "RelevantSurface": "Unspecified"}
                if recipe != self._recipe:
                    body = {"RecipeName": recipe[0], "Revision": recipe[1], "RelevantSurface": "Unspecified"}
                    found.append((f"{_WORK}.RecipeActivated", {**body, "ExpectedUnitsPerWorkTransaction": 1.0}))
                    self._recipe = recipe
            found.append((f"{_WORK}.UnitsArrived", units))
            return [*found, (f"{_WORK}.WorkStarted", started)]
        if record.state == "stitching":
            return [(f"{_WORK}.UnitsDeparted", self._units(run, self._detail(run)))]
        if (result := _WORK_RESULTS.get(record.state)) is None:
            return []
        body = {**self._units(run, self._detail(run)), "TransactionID": transaction, "Result": result}
        figures = self._figures(run)
        measured = [_measurement(transaction, name, value, record.time) for name, value in figures.items()]
        return [(f"{_WORK}.WorkCompleted", body), self._inspected(record, run, "run", measured)]

    def _inspected(
        self, record: EventRecord, run: str, what: str, measured: Sequence[Mapping[str, Any]]
    ) -> tuple[str, dict[str, Any]]:
        """Return the message with the measurements of a run; without a result, "Error" says that there are none."""
        detail, transaction = self._detail(run), identifier(self.handle, run)
        result = "Error" if record.state == "failed" else "Skipped"
        inspection = {
            "UniqueIdentifier": identifier(self.handle, run, what),
            "InspectionName": what,
            "InspectionStartTime": detail.started if detail else None,
            "InspectionEndTime": record.time,
            "Comments": f"{_NOT_JUDGED} {record.message}",
            "Result": result,
            "Verification": "NotVerifiedYet",
            "Error": record.message if result == "Error" else None,
            "DefectsFound": [],
            "Symptoms": [],
            "Measurements": [{**one, "Sequence": number} for number, one in enumerate(measured, 1)],
        }
        unit = {
            "UnitIdentifier": self._units(run, detail)["PrimaryIdentifier"],
            "UnitPositionNumber": 1,
            "OverallResult": result,
            "Inspections": [inspection],
            "Verification": "NotVerifiedYet",
        }
        made = detail.made_with if detail else None
        return f"{_WORK}.TestAndInspection.UnitsInspected", {
            "TransactionId": transaction,
            "InspectionMethod": "AOI",
            "SamplingInformation": {"SamplingMethod": "NoSampling", "LotSize": None, "SampleSize": None},
            "Inspector": {"OperatorIdentifier": self.handle, "ActorType": "Robot"},
            "RecipeName": detail.board_type if detail else None,
            "RecipeRevision": made.board_type_revision if made else None,
            "InspectedUnits": [unit],
        }

    def _detail(self, run: str) -> RunDetail | None:
        try:
            return self._facts.run(run)
        except (GoneError, NotFoundError):
            return None  # the message has waited longer than the run is kept

    def _figures(self, run: str) -> Mapping[str, float]:
        try:
            return self._facts.figures(run)
        except (GoneError, NotFoundError):
            return {}

    def _parts(self, record: EventRecord, run: str) -> list[dict[str, Any]]:
        try:
            content = self._facts.parts(run)
        except (GoneError, NotFoundError):
            content = None
        parts = {} if content is None else json.loads(content)["parts"]
        transaction = identifier(self.handle, run)
        return [
            {**_measurement(transaction, f"{name}:{address}", part[name], record.time), "CRDs": address}
            for address, part in parts.items()
            for name in _MEASURES
            if part.get(name) is not None
        ]

    def _units(self, run: str, detail: RunDetail | None) -> dict[str, Any]:
        """Return the board's id: of its order, else of its code, else `run:` and the id of the station's run.

        The list of units stays empty, since the class of a unit has no status by which nothing is said of the board.
        """
        read = detail.identity.board_id if detail and detail.identity else None
        ordered = detail.board_id if detail else None
        announced = ordered if self._hermes and ordered and _is_guid(ordered) else None
        board = ordered or read or f"run:{run}"
        return {"PrimaryIdentifier": board, "HermesIdentifier": announced, "UnitCount": 1, "Units": []}


def fault_of(handle: str, record: EventRecord) -> dict[str, Any]:
    """Return the structure of a condition (CFX/Structures/Fault.cs)."""
    return {
        "Cause": "ProcessError",
        "Severity": "Error" if record.state == "error" else "Warning",
        "FaultCode": record.code,
        "FaultOccurrenceId": identifier(handle, record.number, record.time, FAULT),
        "SideLocation": "Unknown",
        "AccessType": "Unknown",
        "Description": f"{record.message} {record.action}".strip()[:_LONGEST],
        "DescriptionTranslations": {},
        "OccurredAt": record.time,
    }


def live(name: str, body: Mapping[str, Any], target: str | None = None, request: str | None = None) -> Message:
    """Return a message about the present moment."""
    return Message(name, str(uuid.uuid4()), utc(), body, target, request)


def span(seconds: float) -> str:
    """Return a duration as .NET writes it: [days.]hh:mm:ss[.fraction]."""
    whole = timedelta(seconds=max(0.0, seconds))
    minutes, rest = divmod(whole.seconds, 60)
    days = f"{whole.days}." if whole.days else ""
    fraction = f".{whole.microseconds:06d}0" if whole.microseconds else ""
    return f"{days}{minutes // 60:02d}:{minutes % 60:02d}:{rest:02d}{fraction}"


def _is_guid(text: str) -> bool:
    try:
        return str(uuid.UUID(text)) == text.lower()
    except ValueError:
        return False


def _duration(begin: str, end: str) -> str:
    return span((datetime.fromisoformat(end) - datetime.fromisoformat(begin)).total_seconds())


def _measurement(transaction: str, name: str, value: float, time: str) -> dict[str, Any]:
    stem = name.partition(":")[0]
    return {
        "$type": "CFX.Structures.NumericMeasurement, CFX",
        "UniqueIdentifier": f"{transaction}/{name}",
        "MeasurementName": name,
        "TimeRecorded": time,
        "Result": "Skipped",
        "MeasuredValue": {"Value": value, "ValueUnits": _UNITS.get(stem.rpartition("_")[2])},
    }


@dataclass(frozen=True)
class Endpoint:
    """What the station says about itself."""

    handle: str
    name: str
    uri: str
    requests: str | None
    hermes: bool

    def place(self) -> dict[str, Any]:
        """Return how the station is reached."""
        return {
            "CFXHandle": self.handle,
            "RequestNetworkUri": self.uri if self.requests else None,
            "RequestTargetAddress": self.requests,
        }

    def answer(self, request: Mapping[str, Any]) -> Message | None:
        """Return the answer to a request in its envelope; None if it is meant for others, or is no request."""
        name, body = str(request.get("MessageName", "")), request.get("MessageBody")
        if not name.endswith("Request") or not isinstance(body, Mapping):
            return None
        meant, fine = body.get("CFXHandle"), {"Result": "Success", "ResultCode": 0, "Message": None}
        if (meant or request.get("Target") or self.handle) != self.handle:
            return None
        reply: dict[str, Any]
        if name == "CFX.WhoIsThereRequest" and self._has_topics(body):
            to, reply = "CFX.WhoIsThereResponse", {"Result": fine, **self.place()}
        elif name == "CFX.WhoIsThereRequest":
            return None
        elif name == "CFX.AreYouThereRequest":
            to, reply = "CFX.AreYouThereResponse", {"Result": fine, **self.place()}
        elif name == "CFX.GetEndpointInformationRequest":
            to = "CFX.GetEndpointInformationResponse"
            reply = {"Result": fine, "EndpointInformation": self.information()}
        else:
            text = f"The station does not know {name}."
            to = "CFX.NotSupportedResponse"
            reply = {"RequestResult": {"Result": "Failed", "ResultCode": 1, "Message": text}}
        sender, number = request.get("Source"), request.get("RequestID")
        return live(to, reply, None if sender is None else str(sender), None if number is None else str(number))

    def _has_topics(self, body: Mapping[str, Any]) -> bool:
        """Return whether the station has the topics that CFX/WhoIsThereRequest.cs asks for."""
        wanted = body.get("SupportedTopics")
        rule = body.get("SupportedTopicQueryType", "Ignore")
        if rule not in ("All", "Any") or not isinstance(wanted, list) or not wanted:
            return True
        names = {str(topic.get("TopicName")) for topic in wanted if isinstance(topic, Mapping)}
        own = {topic for topic, _ in _topics()}
        return names <= own if rule == "All" else bool(names & own)

    def information(self) -> dict[str, Any]:
        """Return the structure of CFX/Structures/Endpoint.cs."""
        vendor, model, serial = self.handle.split(".")
        return {
            **self.place(),
            "CFXVersion": VERSION,
            "UniqueIdentifier": self.handle,
            "FriendlyName": self.name,
            "Vendor": vendor,
            "ModelNumber": model,
            "SerialNumber": serial,
            "SoftwareVersion": __version__,
            "OperatingSystem": "OtherLinux",
            "OperatingSystemPlatform": "Platform64bit",
            "OperatingSystemVersion": platform.release(),
            "Stages": [],
            "NumberOfLanes": 1,
            "HermesInformation": {"Enabled": self.hermes, "Version": "1.6" if self.hermes else None},
            "SupportedTopics": [
                {"TopicName": topic, "TopicSupportType": "Publisher", "SupportedMessages": names}
                for topic, names in _topics()
            ],
        }


def _topics() -> list[tuple[str, list[str]]]:
    found: dict[str, list[str]] = {}
    for name in SOURCES:
        if not name.endswith("Response"):
            found.setdefault(name.rpartition(".")[0], []).append(name)
    return list(found.items())
