"""IPC-CFX over real AMQP 1.0: order, ids, times, requests; brokers that are away, restart, refuse, or do not answer."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.peers.certificates import make_authority, make_certificate
from tests.push.amqp_broker import PASSWORD, USER, Broker, Gate, ask, free_port, need_proton
from tests.push.event_list import EventList
from tests.push.test_publisher import until
from vaoi_station.errors import GoneError
from vaoi_station.model import Reason
from vaoi_station.model.receivers import CfxConfig
from vaoi_station.push import cfx, publisher
from vaoi_station.push.cfx import CfxBroker
from vaoi_station.push.cfx_messages import Facts, fault_of
from vaoi_station.push.publisher import Publisher

HANDLE = "vaoi_station.VideoAOI.line-3"
STATION = SimpleNamespace(state="idle", warnings=(), reasons=())


@pytest.fixture(autouse=True)
def _proton() -> None:
    need_proton()


@pytest.fixture
def brokers() -> Iterator[Callable[..., Broker]]:
    """Return a function that makes a broker, which is stopped at the end if it runs."""
    made: list[Broker] = []

    def make(*given: Any) -> Broker:
        made.append(Broker(*given))
        return made[-1]

    yield make
    for broker in made:
        broker.stop()


@pytest.fixture
def broker(brokers: Callable[..., Broker]) -> Broker:
    made = brokers()
    made.start()
    return made


def gone(run: str) -> Any:
    raise GoneError(f"Run {run} is not kept any more.")


def connection(
    port: int,
    events: EventList,
    snapshot: Callable[[], Any] = lambda: STATION,
    limit_s: float = 20.0,
    parts: Callable[[str], Any] = gone,
    **more: Any,
) -> CfxBroker:
    config = CfxConfig(**{"host": "127.0.0.1", "port": port, "address": "cfx"} | more)
    log: Any = events
    return CfxBroker(config, "line-3", log, Facts(snapshot, gone, gone, parts), limit_s=limit_s)


@contextmanager
def published(made: CfxBroker, events: EventList, folder: Path) -> Iterator[Publisher]:
    log: Any = events
    running = Publisher("cfx:broker", folder / "cfx.json", log, made)
    with running.running(lambda _: None):
        yield running


def names(documents: list[dict[str, Any]]) -> list[str]:
    return [document["MessageName"].rpartition(".")[2] for document in documents]


def test_messages_have_the_envelope_and_properties_of_cfx(broker: Broker, events: EventList) -> None:
    made = connection(broker.port, events, requests="line-3")
    assert made.send(events.add("run", "a", state="filming", run="r1")) == (True, "accepted")
    made.close()
    messages = broker.messages(5)
    documents = broker.documents(5)
    order = ["EndpointConnected", "UnitsArrived", "WorkStarted", "Heartbeat", "EndpointShuttingDown"]
    assert names(documents) == order
    started, document = messages[2], documents[2]
    assert document["TimeStamp"] == "2026-01-01T12:00:00.000Z", "that of the event"
    assert document["MessageBody"]["PrimaryIdentifier"] == "run:r1"
    assert (started.id, started.durable, started.reply_to) == (document["UniqueID"], True, "line-3")
    assert started.subject == f"{HANDLE}.CFX.Production.WorkStarted"
    assert started.content_type == cfx.CONTENT_TYPE
    assert started.creation_time == pytest.approx(1767268800.0)
    assert started.properties == {
        "cfx-topic": "CFX.Production", "cfx-message": "CFX.Production.WorkStarted", "cfx-handle": HANDLE,
        "cfx-target": None,
    }  # fmt: skip
    assert documents[0]["MessageBody"]["RequestNetworkUri"] == f"amqp://127.0.0.1:{broker.port}"


def test_what_waited_comes_in_order_and_with_the_same_ids_after_a_restart_of_both(
    tmp_path: Path, events: EventList, brokers: Callable[..., Broker], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(publisher, "PAUSES_S", (0.05,))
    broker = brokers()
    with published(connection(broker.port, events), events, tmp_path) as running:
        events.add("run", "while the broker is away", state="filming", run="r1")
        until(running.reasons)
        assert running.reasons()[0].code == "cfx-lost"
    # The station is started again, and the broker too.
    with published(connection(broker.port, events), events, tmp_path) as running:
        events.add("run", "filmed", state="stitching", run="r1")
        broker.start()
        until(lambda: running.waiting == 0)
        broker.stop()
        events.add("run", "done", state="ready", run="r1")
        until(running.reasons)
        broker.start()
        until(lambda: running.waiting == 0)
        assert running.reasons() == ()
    work = [d for d in broker.documents(6) if d["MessageName"].startswith("CFX.Production")]
    assert names(work) == ["UnitsArrived", "WorkStarted", "UnitsDeparted", "WorkCompleted", "UnitsInspected"]
    again = connection(broker.port, events)
    assert again.send(events.records[0]).delivered
    again.close()
    repeated = [d for d in broker.documents(12) if d["MessageName"] == "CFX.Production.UnitsArrived"]
    assert len({document["UniqueID"] for document in repeated}) == 1
    assert len({document["UniqueID"] for document in work}) == 5


def test_requests_are_answered_where_they_ask_for_it(broker: Broker, events: EventList) -> None:
    made = connection(broker.port, events, requests="line-3")
    made.idle()
    envelope = {"Source": "a.b.c", "RequestID": "q", "MessageBody": {"CFXHandle": HANDLE}}
    asked = ("CFX.WhoIsThere", "CFX.AreYouThere", "CFX.GetEndpointInformation", "CFX.Production.ActivateRecipe")
    for name in asked:
        ask(broker.port, "line-3", {"MessageName": f"{name}Request", **envelope}, "answers")
    ask(broker.port, "line-3", {"MessageName": "CFX.AreYouThereRequest", "MessageBody": {"CFXHandle": "x.y.z"}}, "no")
    ask(broker.port, "line-3", {"MessageName": ["[" * 9]}, "no")
    until(lambda: made.idle() or len([m for a, m in broker.arrived if a == "answers"]) == 4)
    answers = broker.documents(4, "answers")
    assert [a["MessageName"] for a in answers] == [*(f"{n}Response" for n in asked[:3]), "CFX.NotSupportedResponse"]
    assert {(a["Target"], a["RequestID"]) for a in answers} == {("a.b.c", "q")}
    information = answers[2]["MessageBody"]["EndpointInformation"]
    assert (information["Vendor"], information["RequestTargetAddress"]) == ("vaoi_station", "line-3")
    assert not [address for address, _ in broker.arrived if address == "no"]
    made.close()


def test_a_request_whose_answer_breaks_the_connection_comes_once_and_is_answered_elsewhere_next_time(
    broker: Broker, events: EventList
) -> None:
    broker.refused = "nowhere"
    made = connection(broker.port, events, requests="line-3", limit_s=1.0)

    def asked(number: str) -> None:
        body = {"MessageName": "CFX.AreYouThereRequest", "RequestID": number, "MessageBody": {}}
        ask(broker.port, "line-3", body, "nowhere")

    made.idle()
    asked("1")
    until(lambda: (outcome := made.idle()) and not outcome.delivered)
    assert made.send(events.add("run", "a", state="stitching", run="r1")).delivered
    asked("2")
    until(lambda: made.idle() or "AreYouThereResponse" in names(broker.documents(0)))
    made.close()
    assert [d["RequestID"] for d in broker.documents(0) if "Response" in d["MessageName"]] == ["2"]
    assert names(broker.documents(0)).count("EndpointConnected") == 2
    assert len(broker.given) == 2, "each request came once"


def test_waiting_does_not_last_until_a_clock_that_is_set_back_is_right_again(
    broker: Broker, events: EventList, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[float] = []

    def set_back() -> float:
        asked.append(1e9 - 3600 * len(asked))
        assert len(asked) < 100
        return asked[-1]

    made = connection(broker.port, events)
    made.idle()
    monkeypatch.setattr(time, "time", set_back)
    made.idle()
    monkeypatch.undo()
    made.close()


def test_conditions_that_last_longer_than_the_last_events_are_not_told_again_and_end(
    broker: Broker, events: EventList, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cfx, "LOOK_BACK", 3)
    lost = Reason(code="camera-lost", message="Camera 1 is lost.", action="Check the cable.")
    begun = events.add("fault", lost.message, state="error", code=lost.code)
    for _ in range(5):
        events.add("push", "x")
    reasons = [lost]
    made = connection(broker.port, events, lambda: SimpleNamespace(state="idle", warnings=(), reasons=reasons))
    for _ in range(2):
        made._looked_s = 0.0
        made.tend()
        reasons.clear()
    (over,) = events.records[6:]
    assert made.send(over).delivered
    made.close()
    (cleared,) = [d["MessageBody"] for d in broker.documents(0) if d["MessageName"].endswith("FaultCleared")]
    assert cleared["FaultOccurrenceId"] == fault_of(HANDLE, begun)["FaultOccurrenceId"]


def test_conditions_that_begin_and_end_are_faults_with_one_id(broker: Broker, events: EventList) -> None:
    lost = Reason(code="camera-lost", message="Camera 1 is lost.", action="Check the cable.")
    states = iter([(lost,), (lost,), ()])
    made = connection(
        broker.port, events, lambda: SimpleNamespace(state="idle", warnings=(), reasons=next(states)), heartbeat_s=1
    )
    for _ in range(3):
        made._looked_s = 0.0
        made.tend()
    assert [(record.kind, record.state, record.code) for record in events.records] == [
        ("fault", "error", "camera-lost"), ("fault", "over", "camera-lost"),
    ]  # fmt: skip
    assert all(made.send(record).delivered for record in events.records)
    made.close()
    by_name = {d["MessageName"].rpartition(".")[2]: d["MessageBody"] for d in broker.documents(5)}
    fault = by_name["FaultOccurred"]["Fault"]
    assert (fault["FaultCode"], fault["Severity"]) == ("camera-lost", "Error")
    assert by_name["FaultCleared"]["FaultOccurrenceId"] == fault["FaultOccurrenceId"]


def test_password_and_a_wrong_one(broker: Broker, events: EventList, tmp_path: Path) -> None:
    gate, password = Gate(broker.port), tmp_path / "password"
    password.write_text(f"{PASSWORD}\n")
    made = connection(gate.port, events, user=USER, password_file=password)
    assert made.idle() == (True, "connected")
    made.close()
    password.write_text("wrong")
    refused = connection(gate.port, events, user=USER, password_file=password).idle()
    assert refused is not None
    assert not refused.delivered
    assert "Authentication failed" in refused.detail
    gate.close()


def test_the_certificate_of_the_broker_is_checked(
    events: EventList, brokers: Callable[..., Broker], tmp_path: Path
) -> None:
    authority = make_authority(tmp_path)
    broker = brokers(make_certificate(tmp_path, authority=authority))
    broker.start()
    known = connection(broker.port, events, host="localhost", tls=True, ca=authority.certificate)
    assert known.idle() == (True, "connected")
    known.close()
    other = make_authority(tmp_path, "other")
    untrusted = connection(broker.port, events, host="localhost", tls=True, ca=other.certificate).idle()
    assert untrusted is not None
    assert "certificate verify failed" in untrusted.detail


def test_a_broker_may_know_the_station_by_its_certificate(
    events: EventList, brokers: Callable[..., Broker], tmp_path: Path
) -> None:
    authority = make_authority(tmp_path)
    own = make_certificate(tmp_path, "line-3", authority=authority)
    broker = brokers(make_certificate(tmp_path, authority=authority), authority.certificate)
    broker.start()
    secure: dict[str, Any] = {"host": "localhost", "tls": True, "ca": authority.certificate}
    known = connection(broker.port, events, certificate=own.certificate, private_key=own.private_key, **secure)
    assert known.idle() == (True, "connected")
    known.close()
    refused = connection(broker.port, events, **secure).idle()
    assert refused is not None
    assert not refused.delivered


def test_a_broker_that_is_absent_silent_or_has_no_receiver_keeps_the_event(broker: Broker, events: EventList) -> None:
    record = events.add("station", "x", state="idle")
    absent = connection(free_port(), events).send(record)
    assert not absent.delivered
    assert "refused" in absent.detail
    made = connection(broker.port, events, limit_s=1.0)
    made.idle()
    broker.silent.set()
    silent = made.send(record)
    assert not silent.delivered
    assert "timed out" in silent.detail
    broker.silent.clear()
    broker.released = True
    released = made.send(record)
    assert "no process receives what is sent to cfx" in released.detail
    broker.released = False
    assert made.send(record).delivered
    made.close()


def test_a_message_that_the_broker_can_never_take_is_reported_and_left_out(broker: Broker, events: EventList) -> None:
    broker.longest = 1200  # as it is without the properties, the second message would fit
    made = connection(broker.port, events)
    assert made.send(events.add("run", "x", state="ready", run="r1")).delivered
    assert made.send(events.add("run", "y", state="stitching", run="r1")).delivered
    made.close()
    assert names(broker.documents(4))[:2] == ["EndpointConnected", "WorkCompleted"]
    (report,) = [e for e in events.records if e.kind == "push"]
    assert report.code == "events-not-pushed"
    assert "UnitsInspected of event 1" in report.message


def test_an_event_of_which_no_message_can_be_made_holds_up_no_other(broker: Broker, events: EventList) -> None:
    made = connection(broker.port, events, parts=lambda _: b"no document")
    assert made.send(events.add("parts", "x", state="measured", run="r1")).delivered
    assert made.send(events.add("run", "y", state="stitching", run="r1")).delivered
    made.close()
    assert "UnitsDeparted" in names(broker.documents(4))
    (report,) = [e for e in events.records if e.kind == "push"]
    assert (report.code, "event 1: JSONDecodeError" in report.message) == ("events-not-pushed", True)
