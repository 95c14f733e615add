"""`vaoi doctor` and a real controller: the firmware on the emulated chip, behind a pseudo terminal."""

from __future__ import annotations

import os
import tty
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.doctor.conftest import assert_problem, only
from tests.hw.emulated.paced import PacedChip
from tests.hw.emulated.vectors import IDENT
from vaoi_station.acquisition.controller.protocol import (
    FrameReader,
    Link,
    Request,
    Status,
    Type,
)
from vaoi_station.acquisition.controller.serial.exchange import Exchange, Port, Waker
from vaoi_station.config import StationConfig
from vaoi_station.doctor.controller_checks import (
    LATENCY,
    ControllerReply,
    controller,
    judge_contacts,
    judge_encoder,
    judge_latency,
)
from vaoi_station.doctor.finding import Finding, Level
from vaoi_station.doctor.machine import Machine
from vaoi_station.doctor.running_station import CheckContext
from vaoi_station.line_config import Line

RING = {"ring": {"channels": [0, 1], "on_us": 250.0}}


def context_of(port: Path, **settings: Any) -> CheckContext:
    document = {
        "calibration": "c.json",
        "board_types": "types",
        "data": "data",
        "line": {
            "conveyor_mm_s": [0.0, 100.0], "barrier_mm": -40.0, "start_delay_s": 0.32, "trigger_period_s": 0.125,
            "tail_s": 0.48, "longest_board_mm": 60.0,
        },
        "cameras": [
            {"name": "a", "backend": "aravis", "address": "127.0.0.2", "width": 64, "height": 48, "exposure_us": 250.0}
        ],
        "controller": {"backend": "serial", "port": str(port), **settings},
    }  # fmt: skip
    return CheckContext(StationConfig.model_validate(document), Machine(), None)


def by_subject(findings: Iterable[Finding]) -> dict[str, Finding]:
    return {finding.subject: finding for finding in findings}


def asked(port: Path, request: Type) -> Status:
    """Something is done to the controller by hand; how it is afterwards."""
    with closing(Waker()) as waker, closing(Port(str(port), 250_000, waker)) as opened:
        exchange = Exchange(opened, Link(), lambda *_: None, str(port))
        exchange.identify()
        exchange.request(Request(request))
        return Status.unpack(exchange.request(Request(Type.STATUS)).payload)


def test_a_controller_that_is_fit_and_stays_as_it_is(paced: PacedChip) -> None:
    before = asked(paced.link, Type.STATUS)
    found = by_subject(controller(context_of(paced.link, lights=RING)))
    after = asked(paced.link, Type.STATUS)
    assert list(found) == ["port", "firmware", "limits", "state", "clock"]
    # A loaded computer answers late, and the finding on the clock says so, rightly.
    clock = found.pop("clock")
    assert (clock.level is Level.OK) == ("but the limit" not in clock.message), clock
    assert {finding.level for finding in found.values()} == {Level.OK}, found
    assert found["firmware"].figures["firmware"] == "1.4.0"
    assert found["limits"].figures["channel_2_longest_us"] == 500.0
    for name in ("state", "boots", "config_crc", "events_first", "events_next", "run", "row", "events_lost"):
        assert getattr(after, name) == getattr(before, name), name


def test_only_what_is_judged_is_asked(paced: PacedChip, monkeypatch: pytest.MonkeyPatch) -> None:
    """The events of earlier boards are left to the station: their number would make the check slow."""
    sent: list[int] = []

    class NotedLink(Link):
        def outgoing(self, now_s: float) -> bytes:
            data = super().outgoing(now_s)
            sent.extend(message.type for message in FrameReader().feed(data))
            return data

    asked(paced.link, Type.SAFE)
    paced.do("pin PB0 1")
    paced.rest(20)
    assert asked(paced.link, Type.STATUS).events_next > 0
    monkeypatch.setattr("vaoi_station.doctor.controller_checks.Link", NotedLink)
    state = by_subject(controller(context_of(paced.link)))["state"]
    assert_problem(state, Level.WARNING, "safe state (commanded)")
    assert state.figures["barrier"] == "interrupted"
    assert set(sent) == {Type.IDENT, Type.STATUS, Type.CLOCK}


def test_a_light_beyond_the_firmwares_limits(paced: PacedChip) -> None:
    lights = {"flash": {"channels": [2], "on_us": 800.0}}
    limits = by_subject(controller(context_of(paced.link, lights=lights)))["limits"]
    assert_problem(limits, Level.FAULT, "controller.lights.flash.on_us is 800", "500")


def test_contacts_are_shown_and_old_firmware_is_told_apart() -> None:
    status = replace(Status.unpack(bytes(52)), contacts=0b101)
    found = judge_contacts(IDENT, status)
    assert (found.level, found.message) == (Level.OK, "closed: board available, next machine ready")
    assert_problem(judge_contacts(replace(IDENT, minor=3), status), Level.FAULT, "has no contacts", "1.2.3")


def test_an_encoder_is_judged_by_what_it_counts() -> None:
    line = Line.model_validate(
        {
            "conveyor_mm_s": [0.0, 100.0], "barrier_mm": -40.0, "start_delay_s": 0.32, "trigger_period_s": 0.125,
            "tail_s": 0.48, "longest_board_mm": 60.0, "pacing": "encoder", "encoder": {"counts_per_mm": 20.0},
        }
    )  # fmt: skip
    first = Status.unpack(bytes(52))

    def judged(counts: int) -> Finding:
        last = replace(first, position=counts % (1 << 32), tick=2_000_000)
        return judge_encoder(ControllerReply(IDENT, last, (), first), line)

    assert judged(2010).level is Level.OK
    assert "2010 counts in 1.00 s, 100.5 mm/s" in judged(2010).message
    assert (judged(0).level, judged(-500).level, judged(1500).level) == (Level.WARNING, Level.FAULT, Level.WARNING)
    assert "at rest, or it does not count" in judged(0).message
    assert "counts backwards" in judged(-500).message
    assert "75.0 mm/s by encoder.counts_per_mm, but conveyor_mm_s is 100 mm/s" in judged(1500).message


@pytest.fixture
def terminal() -> Iterator[tuple[int, Path]]:
    """A pseudo terminal: our end, and the name of the other one."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    yield ours, Path(os.ttyname(theirs))
    os.close(ours)
    os.close(theirs)


def test_a_bridge_that_keeps_bytes_back(tmp_path: Path) -> None:
    latency = tmp_path / LATENCY.format(name="ttyUSB0")
    latency.parent.mkdir(parents=True)
    latency.write_text("16\n")
    assert_problem(only(judge_latency(Path("/nowhere/ttyUSB0"), Machine(tmp_path))), Level.WARNING, "16 ms")
    latency.write_text("1\n")
    assert list(judge_latency(Path("/nowhere/ttyUSB0"), Machine(tmp_path))) == []
