"""What CFX messages say of events: names and values of the standard's classes, ids, states, boards, no judgement."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from types import SimpleNamespace
from typing import Any

import pytest

from vaoi_station.errors import NotFoundError
from vaoi_station.push.cfx_messages import (
    SOURCES,
    STATES,
    Endpoint,
    Facts,
    History,
    Translator,
    fault_of,
    identifier,
    span,
)
from vaoi_station.runs.states.schemas import EventRecord
from vaoi_station.runs.states.tables import StationState

HANDLE = "Vendor.Model.Serial"
ENDPOINT = Endpoint(HANDLE, "line-3", "amqp://broker:5672", "requests", hermes=True)

# Properties of the classes below CFX/ in IPCConnectedFactoryExchange/CFX 2.1.1, which the tests compare with.
_REQUEST_RESULT = "Result ResultCode Message"  # Structures/RequestResult.cs
_PLACE = "CFXHandle RequestNetworkUri RequestTargetAddress"
_UNITS = "PrimaryIdentifier HermesIdentifier UnitCount Units"
_RECIPE = "RecipeName Revision RelevantSurface WorkOrderIdentifier"
_FAULT = (  # Structures/Fault.cs
    "TransactionID Cause Severity FaultCode FaultOccurrenceId Lane Stage SideLocation AccessType Description "
    "DescriptionTranslations OccurredAt DueDateTime"
)
CLASSES = {
    "EndpointConnected": _PLACE,
    "EndpointShuttingDown": "CFXHandle",
    "Heartbeat": "CFXHandle HeartbeatFrequency ActiveFaults ActiveRecipes",
    "WhoIsThereResponse": f"Result {_PLACE}",
    "AreYouThereResponse": f"Result {_PLACE}",
    "GetEndpointInformationResponse": "Result EndpointInformation",
    "NotSupportedResponse": "RequestResult",
    "StationOnline": "OfflineDuration",
    "StationOffline": "",
    "StationStateChanged": "OldState OldStateDuration NewState RelatedFault",
    "FaultOccurred": "Fault",
    "FaultCleared": "FaultOccurrenceId Operator",
    "RecipeActivated": (
        f"{_RECIPE} Lane Stage ExpectedCycleTime ExpectedWorkTime ExpectedUnitsPerWorkTransaction "
        "NumberOfComponentsPerUnit TargetQuantity RecipeStagesInformation"
    ),
    "UnitsArrived": f"{_UNITS} Lane",
    "UnitsDeparted": f"{_UNITS} Lane",
    "WorkStarted": f"{_UNITS} TransactionID Lane {_RECIPE}",
    "WorkCompleted": f"{_UNITS} TransactionID Result PerformanceImpacts",
    "UnitsInspected": (
        "TransactionId InspectionMethod SamplingInformation Inspector RecipeName RecipeRevision InspectedUnits "
        "InspectedPanel"
    ),
}
INSIDE = {
    "Fault": _FAULT,
    "ActiveFaults": _FAULT,
    "RequestResult": _REQUEST_RESULT,
    "SamplingInformation": "SamplingMethod LotSize SampleSize",
    "Inspector": "OperatorIdentifier ActorType LastName FirstName LoginName",  # Structures/Operator.cs
    "InspectedUnits": ("UnitIdentifier UnitPositionNumber OverallResult Inspections Verification TotalInspectionCount"),
    "Inspections": (
        "UniqueIdentifier InspectionName InspectionStartTime InspectionEndTime TestProcedure Comments Result "
        "Verification VerificationDetail Error DefectsFound Symptoms Measurements RefNo"
    ),
    "Measurements": (  # Structures/NumericMeasurement.cs and Measurement.cs
        "$type UniqueIdentifier MeasurementName TimeRecorded Sequence Result CRDs MeasuredValue"
    ),
    "MeasuredValue": "Value ValueUnits ExpectedValue ExpectedValueUnits",  # Structures/NumericValue.cs
    "EndpointInformation": (  # Structures/Endpoint.cs
        f"{_PLACE} CFXVersion UniqueIdentifier FriendlyName Vendor ModelNumber SerialNumber SoftwareVersion "
        "FirmwareVersion OperatingSystem OperatingSystemPlatform OperatingSystemVersion Stages NumberOfLanes "
        "HermesInformation OperatingRequirements SupportedTopics SupportedPCBDimensions SleepStates"
    ),
    "HermesInformation": "Enabled Version",
    "SupportedTopics": "TopicName TopicSupportType SupportedMessages",
}
"""Properties of the structures that stand below a property."""
VALUES = {
    "OverallResult": "Passed Failed Error Aborted Skipped",  # Structures/TestResult.cs
    "Verification": "NotVerifiedYet DefectConfirmed DefectRejected",  # Structures/VerificationResult.cs
    "InspectionMethod": "Human AOI SPI AXI",
    "SamplingMethod": "NoSampling",
    "ActorType": "Human Robot RemoteSystem",
    "RelevantSurface": "Unspecified PrimarySurface SecondarySurface",  # Structures/Surface.cs
    "Cause": "ProcessError",  # Structures/FaultCause.cs
    "Severity": "Information Warning Error Alarm",  # Structures/FaultSeverity.cs
    "SideLocation": "Unknown",
    "AccessType": "Unknown",
    "OperatingSystem": "OtherLinux",
    "OperatingSystemPlatform": "Platform64bit",
    "TopicSupportType": "Publisher Consumer PublisherConsumer",
}


def event(number: int, kind: str, state: str, **more: Any) -> EventRecord:
    return EventRecord(number=number, time=f"2026-01-01T12:00:{number:02d}.000Z", kind=kind, state=state, **more)


def run_detail(board_id: str | None = "B-7", read: str | None = None, **more: Any) -> Any:
    made = SimpleNamespace(board_type_revision="C")
    found = {"board_type": "demo", "board_id": board_id, "made_with": made, "started": "2026-01-01T12:00:00.000Z"}
    identity = None if read is None else SimpleNamespace(board_id=read)
    return SimpleNamespace(**found | {"identity": identity} | more)


def translator(detail: Any = None, parts: Mapping[str, Any] | None = None) -> Translator:
    def run(_: str) -> Any:
        if detail is None:
            raise NotFoundError("There is no such run.")
        return detail

    def figures(_: str) -> dict[str, float]:
        run(_)
        return {"sigma_px": 0.01, "belt_mm_s": 99.5, "seam_px:0-1": 0.2, "unseen_parts": 0.0}

    content = None if parts is None else json.dumps({"parts": parts}).encode()
    snapshot: Any = None
    return Translator(HANDLE, Facts(snapshot, run, figures, lambda _: content))


def bodies(made: Translator, record: EventRecord, history: History | None = None) -> list[tuple[str, Any]]:
    return [(m.name.rpartition(".")[2], m.body) for m in made.messages(record, history or History())]


def every_message() -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield a body of every message that comes from an event, or answers a request."""
    made, history = translator(run_detail(), {"R1": {"dx_mm": 0.1, "presence": 1.0}}), History()
    begun = event(3, "fault", "error", code="camera-lost", message="Lost.")
    records = [
        event(1, "station", "idle"), event(2, "station", "armed"), begun,
        event(4, "fault", "over", code="camera-lost"), event(5, "run", "filming", run="r"),
        event(6, "run", "stitching", run="r"), event(7, "run", "degraded", run="r"),
        event(8, "parts", "measured", run="r"), event(9, "run", "failed", run="r"), event(10, "station", "stopping"),
    ]  # fmt: skip
    for record in records:
        yield from ((m.name, m.body) for m in made.messages(record, history))
        history.add([record])
    for name in ("WhoIsThere", "AreYouThere", "GetEndpointInformation", "Other"):
        answer = ENDPOINT.answer({"MessageName": f"CFX.{name}Request", "MessageBody": {}})
        assert answer is not None
        yield answer.name, answer.body
    yield "CFX.EndpointConnected", ENDPOINT.place()
    yield "CFX.EndpointShuttingDown", {"CFXHandle": HANDLE}
    active = [fault_of(HANDLE, begun)]
    yield "CFX.Heartbeat", {"CFXHandle": HANDLE, "HeartbeatFrequency": span(60), "ActiveFaults": active}


def unknown(body: Any, where: str, known: str) -> Iterator[str]:
    """Yield what the class of a structure does not have."""
    for key, value in body.items():
        if key not in known.split():
            yield f"{where}.{key}"
        elif key in VALUES and value not in VALUES[key].split():
            yield f"{where}.{key} = {value}"
        inside = _REQUEST_RESULT if key == "Result" and isinstance(value, dict) else INSIDE.get(key)
        for one in value if isinstance(value, list) else [value]:
            if isinstance(one, dict) and (inside is not None or one):
                yield from unknown(one, f"{where}.{key}", inside or "")


def test_every_message_has_only_names_and_values_of_its_class() -> None:
    seen = set()
    for name, body in every_message():
        seen.add(name)
        assert list(unknown(body, name, CLASSES[name.rpartition(".")[2]])) == []
    assert seen == set(SOURCES)


def test_nothing_is_passed_and_units_have_no_status() -> None:
    for name, body in every_message():
        assert '"Passed"' not in json.dumps(body), name
        assert body.get("Units", []) == []


@pytest.mark.parametrize(
    ("detail", "expected"),
    [
        (run_detail("B-7", "other"), "B-7"),
        (run_detail(None, "read"), "read"),
        (run_detail(None), "run:r"),
        (None, "run:r"),
    ],
)
def test_the_board_is_that_of_the_order_or_of_the_code_or_the_run(detail: Any, expected: str) -> None:
    for state in ("filming", "stitching", "ready"):
        made = dict(bodies(translator(detail), event(1, "run", state, run="r")))
        for name in ("UnitsArrived", "WorkStarted", "UnitsDeparted", "WorkCompleted"):
            assert made.get(name, {"PrimaryIdentifier": expected})["PrimaryIdentifier"] == expected
        for unit in made.get("UnitsInspected", {}).get("InspectedUnits", []):
            assert unit["UnitIdentifier"] == expected


@pytest.mark.parametrize(
    ("board", "hermes"),
    [("B-7", False), ("0" * 32, False), ("b8c1c0de-0000-4000-8000-123456789abc", True)],
)
def test_the_id_with_which_hermes_announced_a_board_is_named_as_such(board: str, hermes: bool) -> None:
    made = translator(run_detail(board))
    made._hermes = True
    arrived = dict(bodies(made, event(1, "run", "filming", run="r")))["UnitsArrived"]
    assert arrived["HermesIdentifier"] == (board if hermes else None)


@pytest.mark.parametrize(
    ("state", "work", "judged"),
    [("ready", "Completed", "Skipped"), ("degraded", "Failed", "Skipped"), ("failed", "Aborted", "Error")],
)
def test_a_verdict_is_the_result_of_the_work_and_no_judgement(state: str, work: str, judged: str) -> None:
    made = dict(bodies(translator(run_detail()), event(1, "run", state, run="r", message="why")))
    assert made["WorkCompleted"]["Result"] == work
    (unit,) = made["UnitsInspected"]["InspectedUnits"]
    (inspection,) = unit["Inspections"]
    assert {unit["OverallResult"], inspection["Result"]} == {judged}
    assert "why" in inspection["Comments"]
    assert made["UnitsInspected"]["TransactionId"] == made["WorkCompleted"]["TransactionID"]
    units = {one["MeasurementName"]: one["MeasuredValue"]["ValueUnits"] for one in inspection["Measurements"]}
    assert units == {"sigma_px": "px", "belt_mm_s": "mm/s", "seam_px:0-1": "px", "unseen_parts": None}


def test_parts_come_with_their_designators() -> None:
    parts = {"R1": {"dx_mm": 0.1, "turn_deg": None, "presence": 0.9}, "U2": {"reasons": ["few-views"]}}
    (name, body), *more = bodies(translator(run_detail(), parts), event(1, "parts", "measured", run="r"))
    measured = body["InspectedUnits"][0]["Inspections"][0]["Measurements"]
    assert (name, more) == ("UnitsInspected", [])
    found = [(one["CRDs"], one["MeasurementName"], one["MeasuredValue"]["Value"]) for one in measured]
    assert found == [("R1", "presence:R1", 0.9), ("R1", "dx_mm:R1", 0.1)]
    assert bodies(translator(run_detail()), event(1, "parts", "measured", run="r")) == []


def test_a_recipe_is_activated_once_until_another_comes() -> None:
    detail = run_detail()
    made = translator(detail)
    first = [name for name, _ in bodies(made, event(1, "run", "filming", run="r"))]
    assert first == ["RecipeActivated", "UnitsArrived", "WorkStarted"]
    assert "RecipeActivated" not in dict(bodies(made, event(2, "run", "filming", run="s")))
    detail.board_type = "another"
    assert "RecipeActivated" in dict(bodies(made, event(3, "run", "filming", run="t")))


def test_states_have_their_predecessor_also_over_a_stop_and_a_crash() -> None:
    made, history = translator(), History(first=5)
    records = [
        event(1, "station", "armed"), event(2, "station", "stopping"), event(4, "station", "armed"),
        event(6, "station", "idle"), event(7, "station", "arming"), event(9, "station", "armed"),
    ]  # fmt: skip
    found = []
    for record in records:
        found.append(bodies(made, record, history))
        history.add([record])
    (_, (_, off)), started, crashed, none, ((_, changed),) = found[1:]
    assert [name for name, _ in found[1]] == ["StationStateChanged", "StationOffline"]
    assert off == {}
    assert none == [], "two states of the station are one of CFX, and its time is that of both"
    assert started[0] == ("StationOnline", {"OfflineDuration": "00:00:02"})
    # The events from number 5 on are those of another start, before which nothing was written.
    assert crashed[0] == ("StationOnline", {"OfflineDuration": None})
    assert crashed[1][1]["OldState"] == STATES[StationState.STARTING]
    assert (changed["OldState"], changed["OldStateDuration"], changed["NewState"]) == ("2000", "00:00:03", "2200")
    assert set(STATES) == set(StationState)


def test_ids_repeat_for_the_same_event_and_differ_otherwise() -> None:
    def ids(number: int) -> list[str]:
        return [m.id for m in translator(run_detail()).messages(event(number, "run", "filming", run="r"), History())]

    assert ids(1) == ids(1)
    assert not set(ids(1)) & set(ids(2))
    assert len(set(ids(1))) == 3
    assert identifier("a.b.c", 1) != identifier("a.b.d", 1)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0, "00:00:00"), (60, "00:01:00"), (90061.5, "1.01:01:01.5000000"), (-1, "00:00:00")],
)
def test_durations_are_those_of_dotnet(seconds: float, text: str) -> None:
    assert span(seconds) == text


@pytest.mark.parametrize(
    ("rule", "topics", "answered"),
    [
        ("Ignore", ["CFX.Other"], True), ("All", ["CFX.Production"], True), ("Any", ["CFX.Other", "CFX"], True),
        ("All", ["CFX.Production", "CFX.Other"], False), ("Any", ["CFX.Other"], False), ("All", 7, True),
        ([], ["CFX.Other"], True), ("All", [["CFX"]], False),
    ],
)  # fmt: skip
def test_who_is_there_asks_for_topics(rule: Any, topics: Any, answered: bool) -> None:
    wanted = [{"TopicName": topic} for topic in topics] if isinstance(topics, list) else topics
    body = {"SupportedTopicQueryType": rule, "SupportedTopics": wanted}
    assert (ENDPOINT.answer({"MessageName": "CFX.WhoIsThereRequest", "MessageBody": body}) is not None) is answered


@pytest.mark.parametrize(
    "request_",
    [
        {}, {"MessageName": "CFX.Heartbeat", "MessageBody": {}}, {"MessageName": "CFX.AreYouThereRequest"},
        {"MessageName": "CFX.AreYouThereRequest", "Target": "x.y.z", "MessageBody": {}},
        {"MessageName": "CFX.AreYouThereRequest", "MessageBody": {"CFXHandle": ["[" * 99]}},
        {"MessageName": 3, "MessageBody": []},
        {"MessageName": "CFX.WhoIsThereRequest", "MessageBody": {
            "SupportedTopicQueryType": "Any", "SupportedTopics": [3, {"TopicName": "x"}]}},
    ],
)  # fmt: skip
def test_what_is_no_request_to_this_station_is_not_answered(request_: dict[str, Any]) -> None:
    assert ENDPOINT.answer(request_) is None
