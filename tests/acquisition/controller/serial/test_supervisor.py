"""The supervisor brings a controller into the wanted state, whatever it finds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager

import pytest

from tests.acquisition.controller.serial.fake_firmware import FakeFirmware
from vaoi_station.acquisition.cameras.interface import DeviceFault
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    ControllerEvent,
    PulseFired,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.controller.protocol import Fault, Kind, Nak, Reason, State, Type
from vaoi_station.acquisition.controller.serial.controller import Supervisor
from vaoi_station.acquisition.controller.serial.exchange import ResetError, SilentError, Waker
from vaoi_station.config import ControllerConfig, LightConfig
from vaoi_station.errors import DeviceError, InputError, StateError

PLAN = TriggerPlan(start_delay_s=0.3, period_s=0.12, tail_s=0.4, max_rows=40, debounce_s=0.005)
LIGHTS = {"top": LightConfig(channels=(0,), on_us=300.0)}
Device = tuple[str, FakeFirmware]


class Bench:
    """A supervisor, its controller, and what was reported."""

    def __init__(self, device: Device, waker: Waker) -> None:
        name, self.firmware = device
        self.supervisor = Supervisor(ControllerConfig(backend="serial", port=name, lights=LIGHTS), waker)
        self.reported: list[ControllerEvent | DeviceFault] = []
        self.supervisor.translator.start(self.reported.append)
        self.supervisor.connect()

    def poll_until(self, condition: Callable[[], bool]) -> None:
        for _ in range(200):
            if condition():
                return
            self.supervisor.poll()
        raise AssertionError("did not happen")

    def faults(self) -> list[str]:
        return [item.error.code for item in self.reported if isinstance(item, DeviceFault)]


@contextmanager
def connected(device: Device) -> Iterator[Bench]:
    with closing(Waker()) as waker:
        bench = Bench(device, waker)
        yield bench
        bench.supervisor.disconnect()


@pytest.fixture
def bench(device: Device) -> Iterator[Bench]:
    with connected(device) as bench:
        yield bench


def test_connecting_identifies_the_controller_and_fits_its_clock(bench: Bench) -> None:
    assert bench.supervisor.ident.boots == 1
    assert bench.firmware.requests[0] == Type.IDENT
    assert bench.firmware.requests.count(Type.CLOCK) == 8
    assert bench.supervisor.unavailable is None


def test_a_controller_that_an_earlier_process_left_armed_is_disarmed(device: Device) -> None:
    device[1].state = State.ARMED
    with connected(device) as bench:
        assert bench.firmware.in_state(State.IDLE)


def test_arming_sends_the_configuration_once(bench: Bench) -> None:
    bench.supervisor.arm(PLAN)
    assert bench.firmware.in_state(State.ARMED)
    bench.supervisor.disarm()
    assert bench.firmware.in_state(State.IDLE)
    bench.supervisor.arm(PLAN)
    assert bench.firmware.requests.count(Type.COMMIT) == 1, "the checksum shows that it is active already"


def test_each_arming_has_a_number_of_its_own(bench: Bench) -> None:
    bench.supervisor.arm(PLAN)
    first = bench.firmware.run
    bench.supervisor.disarm()
    bench.supervisor.arm(PLAN)
    assert bench.firmware.run == (first + 1) % 0x10000


def test_a_limit_of_the_firmware_is_explained_in_terms_of_the_plan(bench: Bench) -> None:
    bench.firmware.refuse[Type.COMMIT] = Nak(Type.COMMIT, Reason.RANGE, 4, 1_000_000)
    with pytest.raises(InputError, match=r"period_s is 0\.12, but must be at least 0\.5"):
        bench.supervisor.arm(PLAN)
    assert bench.supervisor.arming is None


def test_an_armed_controller_that_stops_watching_is_armed_again(bench: Bench) -> None:
    bench.supervisor.arm(PLAN)
    bench.firmware.state = State.SAFE
    bench.firmware.emit(Kind.FAULT, Fault.HEARTBEAT)
    bench.poll_until(lambda: bench.firmware.in_state(State.ARMED))
    assert bench.faults() == ["controller-safe"]


def test_after_its_guard_tripped_it_stays_disarmed(bench: Bench) -> None:
    bench.supervisor.arm(PLAN)
    bench.firmware.state = State.SAFE
    bench.firmware.emit(Kind.FAULT, Fault.GUARD)
    bench.poll_until(lambda: bench.supervisor.guard_tripped)
    beats = bench.firmware.requests.count(Type.BEAT)
    bench.poll_until(lambda: bench.firmware.requests.count(Type.BEAT) > beats + 2)
    assert bench.firmware.in_state(State.SAFE)
    bench.supervisor.arm(PLAN)
    assert bench.firmware.in_state(State.ARMED)


def test_after_a_reset_it_is_armed_again_and_the_run_has_ended(bench: Bench) -> None:
    bench.supervisor.arm(PLAN)
    bench.firmware.emit(Kind.BARRIER, 1)
    bench.firmware.emit(Kind.PULSE, 1, 0, 600)
    bench.poll_until(lambda: any(isinstance(item, PulseFired) for item in bench.reported))
    bench.firmware.reset()
    with pytest.raises(ResetError):
        bench.poll_until(lambda: False)
    bench.supervisor.connect()
    assert bench.firmware.in_state(State.ARMED)
    ends = [item for item in bench.reported if isinstance(item, RunEnded)]
    assert [(e.pulses, e.reason) for e in ends] == [(1, "the controller was reset")]
    (fault,) = [item.error for item in bench.reported if isinstance(item, DeviceFault)]
    assert "its reset line was pulled" in fault.message
    assert "the run under way was ended" in fault.message


def test_a_run_whose_end_was_lost_ends_with_the_next_status(bench: Bench) -> None:
    bench.supervisor.arm(PLAN)
    bench.firmware.emit(Kind.BARRIER, 1)
    bench.poll_until(lambda: any(isinstance(item, BarrierBlocked) for item in bench.reported))
    bench.poll_until(lambda: any(isinstance(item, RunEnded) for item in bench.reported))
    (end,) = [item for item in bench.reported if isinstance(item, RunEnded)]
    assert end.reason == "the controller's report of its end was lost"


def test_an_arming_that_is_dropped_while_it_is_away_is_not_restored(bench: Bench) -> None:
    bench.supervisor.arm(PLAN)
    bench.supervisor.mark_lost(DeviceError("The cable is out."))
    bench.supervisor.disconnect()
    bench.supervisor.drop_arming()
    bench.supervisor.connect()
    assert bench.firmware.in_state(State.IDLE)


def test_without_a_port_nothing_can_be_requested(bench: Bench) -> None:
    bench.supervisor.disconnect()
    with pytest.raises(SilentError, match="not connected"):
        bench.supervisor.read_clock()


def test_one_pulse_is_reported_with_the_light_of_row_0(bench: Bench) -> None:
    bench.supervisor.fire_one()
    bench.poll_until(lambda: len(bench.reported) == 2)
    pulse, end = bench.reported
    assert isinstance(pulse, PulseFired)
    assert pulse.light == "top"
    assert isinstance(end, RunEnded)


@pytest.mark.parametrize(
    ("reason", "words"), [(Reason.LED_BUDGET, "have not cooled down"), (Reason.STATE, "is still under way")]
)
def test_a_pulse_that_must_wait_is_no_fault(bench: Bench, reason: Reason, words: str) -> None:
    bench.firmware.refuse[Type.FIRE_ONE] = Nak(Type.FIRE_ONE, reason, 0, 0)
    with pytest.raises(StateError, match=words):
        bench.supervisor.fire_one()


def test_an_armed_controller_fires_no_single_pulse(bench: Bench) -> None:
    bench.supervisor.arm(PLAN)
    with pytest.raises(StateError, match="armed"):
        bench.supervisor.fire_one()
