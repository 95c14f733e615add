"""The firmware's events become those of the interface; whatever was lost, every run that begins also ends."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.cameras.interface import DeviceFault
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    BarrierEdge,
    ControllerEvent,
    PulseFired,
    PulseSkipped,
    RunEnded,
)
from vaoi_station.acquisition.controller.protocol import ROW_NONE, Event, Fault, Kind, RunEnd, Suppressed
from vaoi_station.acquisition.controller.serial.controller import EventTranslator


class Recorder:
    def __init__(self) -> None:
        self.translator = EventTranslator()
        self.events: list[ControllerEvent | DeviceFault] = []
        self.translator.start(self.events.append)
        self.translator.set_lights(lambda row, _channels: f"light {row}", "single light")

    def receive(self, *events: tuple[Kind, int, int, int]) -> list[ControllerEvent | DeviceFault]:
        """(kind, detail, index, value) each, a second apart."""
        for number, (kind, detail, index, value) in enumerate(events):
            self.translator.translate(Event(number, 2_000_000 * number, kind, detail, index, value), float(number))
        return self.events


def test_rows_left_out_are_rows_of_the_run() -> None:
    events = Recorder().receive(
        (Kind.BARRIER, 1, 7, 0),
        (Kind.SUPPRESSED, Suppressed.LED_BUDGET, 0, 2),
        (Kind.PULSE, 1, 1, 600),
        (Kind.SUPPRESSED, Suppressed.LATE, 2, 0),
        (Kind.BARRIER, 0, 7, 0),
        (Kind.RUN_END, RunEnd.CLEAR, 1, 2),
    )
    assert [type(t).__name__ for t in events] == [
        "BarrierBlocked", "PulseSkipped", "PulseFired", "PulseSkipped", "BarrierClear", "RunEnded",
    ]  # fmt: skip
    skipped = [t for t in events if isinstance(t, PulseSkipped)]
    assert [s.index for s in skipped] == [0, 2]
    assert "had not cooled down" in skipped[0].reason
    end = events[-1]
    assert isinstance(end, RunEnded)
    assert (end.pulses, end.reason) == (3, "clear")
    assert isinstance(events[2], PulseFired)
    assert events[2].light == "light 1"


def test_a_single_pulse_is_a_run_of_its_own() -> None:
    pulse, end = Recorder().receive((Kind.PULSE, 1, ROW_NONE, 600))
    assert isinstance(pulse, PulseFired)
    assert (pulse.index, pulse.light) == (0, "single light")
    assert isinstance(end, RunEnded)
    assert (end.pulses, end.reason) == (1, "single")


def test_a_run_whose_begin_was_lost_does_not_end() -> None:
    assert Recorder().receive((Kind.RUN_END, RunEnd.CLEAR, 5, 0)) == []


def test_every_edge_has_the_position_of_the_encoder() -> None:
    edges = ((Kind.BARRIER, 1), (Kind.BARRIER, 0), (Kind.EDGE, 1), (Kind.EDGE, 0))
    events = Recorder().receive(*((kind, detail, 7, 2**32 - 3 + n) for n, (kind, detail) in enumerate(edges)))
    assert [e.counts for e in events if isinstance(e, BarrierEdge)] == [2**32 - 3 + n for n in range(4)]


def test_boards_too_close_and_faults_are_reported() -> None:
    events = Recorder().receive(
        (Kind.SUPPRESSED, Suppressed.GAP, ROW_NONE, 40_000),
        (Kind.FAULT, Fault.HEARTBEAT, 0, 0),
        (Kind.FAULT, Fault.GUARD, 0, 0),
    )
    errors = [t.error for t in events if isinstance(t, DeviceFault)]
    assert [e.code for e in errors] == ["board-too-soon", "controller-safe", "controller-safe"]
    assert "0.020 s after the one before had left" in errors[0].message
    assert all(e.action for e in errors)


EVENTS = st.tuples(
    st.sampled_from(sorted(Kind)), st.integers(0, 5), st.sampled_from([0, 1, 2, 5, ROW_NONE]), st.integers(0, 9)
)


@given(st.lists(EVENTS, max_size=30))
def test_whatever_is_lost_runs_do_not_overlap_and_numbers_have_no_gaps(
    events: list[tuple[Kind, int, int, int]],
) -> None:
    recorder = Recorder()
    recorder.receive(*events)
    recorder.translator.end("over")
    reported = [t for t in recorder.events if isinstance(t, ControllerEvent)]
    assert all(b.number == a.number + 1 for a, b in pairwise(reported))
    open_runs = 0
    for event in reported:
        if isinstance(event, BarrierBlocked):
            assert open_runs == 0
            open_runs = 1
        elif isinstance(event, RunEnded) and event.reason != "single":
            open_runs = 0
    assert open_runs == 0
    assert not recorder.translator.running


def test_a_pulse_has_the_light_and_the_on_time_that_were_reported() -> None:
    recorder = Recorder()
    recorder.translator.set_lights(lambda row, channels: f"{row}:{channels:b}", "")
    pulse = recorder.receive((Kind.PULSE, 0b101, 4, 600))[0]
    assert isinstance(pulse, PulseFired)
    assert (pulse.light, pulse.on_us) == ("4:101", 300.0)
