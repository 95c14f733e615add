"""The station's end of the line and the real firmware, with a terminal between them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from tests.hw.emulated.host import PLAN, Host
from tests.hw.emulated.paced import HZ, PacedChip
from vaoi_station.acquisition.cameras.interface import DeviceFault
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    BarrierBlockedAgain,
    BarrierBounce,
    BarrierClear,
    BarrierClearAfterRun,
    ControllerEvent,
    PulseFired,
    RunEnded,
)
from vaoi_station.acquisition.controller.serial import SerialController
from vaoi_station.acquisition.process.backends import open_devices
from vaoi_station.config import ControllerConfig, StationConfig
from vaoi_station.errors import DeviceError, StateError
from vaoi_station.line_config import Line
from vaoi_station.model import ProgramRow

ROOT = Path(__file__).resolve().parents[2]

PIN = "PC0"
"""The output "line ready"."""


@contextmanager
def armed_process(chip: PacedChip) -> Iterator[tuple[subprocess.Popen[str], Iterator[str]]]:
    """Arm the chip from another process; return the process and its lines of events. The process is killed at exit."""
    with subprocess.Popen(
        [sys.executable, "-m", "tests.hw.emulated.serial_host", str(chip.link)],
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    ) as process:
        try:
            assert process.stdout is not None
            lines = iter(process.stdout)
            assert next(lines) == "armed\n"
            yield process, lines
        finally:
            process.kill()


def test_a_board_passes(host: Host) -> None:
    """Rows, lights and numbers; the times agree with the side channel within the clock's own bound."""
    host.controller.arm(PLAN)
    for _ in range(4):
        host.chip.do("pin PD2 0")
        host.clock.add(host.controller.read_clock())
    host.seen.clear()
    rises = len(host.chip.rises("PB1"))
    edge = host.chip.board(100)
    end = host.next(RunEnded)
    events = [item for item in host.seen if isinstance(item, ControllerEvent)]
    blocked, pulses = events[0], host.pulses()
    assert isinstance(blocked, BarrierBlocked)
    assert [p.index for p in pulses] == list(range(6))
    assert [p.light for p in pulses] == ["top", "low", "top"] * 2
    assert (end.pulses, end.reason) == (6, "clear")
    assert sum(isinstance(e, BarrierClear) for e in events) == 1
    assert [b.number - a.number for a, b in pairwise(events)] == [1] * (len(events) - 1)
    assert pulses[0].time_s - blocked.time_s == pytest.approx(PLAN.start_delay_s, abs=1e-6)
    cycles = host.chip.rises("PB1")[rises:]
    assert len(cycles) == len(pulses)
    for time_s, cycle in [(blocked.time_s, edge), *((p.time_s, c) for p, c in zip(pulses, cycles, strict=True))]:
        assert abs(host.clock.host_s(time_s) - host.chip.host_s(cycle)) <= host.clock.bound_s(time_s)


def test_boards_one_after_another_until_it_is_disarmed(host: Host) -> None:
    host.controller.arm(PLAN)
    assert [len(host.run()) for _ in range(3)] == [6, 6, 6]
    host.chip.do("pin PB0 1")
    host.next(PulseFired)
    host.controller.disarm()
    assert host.next(RunEnded).reason == "disarmed"
    host.chip.do("pin PB0 0")
    host.chip.rest(20)
    before = len(host.chip.rises("PB1"))
    host.seen.clear()
    host.chip.board(100)
    host.chip.rest(250)
    assert len(host.chip.rises("PB1")) == before
    assert host.seen == []


def test_every_edge_of_boards_that_follow_too_closely_is_reported(host: Host) -> None:
    """The second board blocks the barrier within the tail of the first, and leaves it after the end of the run."""
    host.controller.arm(PLAN)
    now = host.chip.do("pin PD2 0")
    # A loaded computer takes its time to give the four orders; the chip's clock runs on meanwhile.
    for ms, level in ((1050, 1), (1150, 0), (1170, 1), (1750, 0)):
        host.chip.do(f"at {now + ms * HZ // 1000} PB0 {level}")
    assert host.next(RunEnded).reason == "max-rows"
    clear = host.next(BarrierClearAfterRun)
    edges = [e for e in host.seen if isinstance(e, BarrierBlocked | BarrierClear | BarrierBlockedAgain)]
    assert [type(e) for e in edges] == [BarrierBlocked, BarrierClear, BarrierBlockedAgain]
    assert [e.time_s - edges[0].time_s for e in [*edges, clear]] == pytest.approx([0, 0.1, 0.12, 0.7], abs=1e-4)
    host.seen.clear()
    host.chip.rest(20)
    assert len(host.run()) == 6


def test_a_board_that_is_in_the_barrier_when_the_line_is_armed_is_known_before_it_leaves(host: Host) -> None:
    host.chip.do("pin PB0 1")
    host.chip.rest(20)
    host.controller.arm(PLAN)
    assert host.controller.barrier_blocked() is True
    host.seen.clear()
    host.chip.do("pin PB0 0")
    host.next(BarrierClearAfterRun)
    assert [type(event) for event in host.seen if isinstance(event, ControllerEvent)] == [BarrierClearAfterRun]
    waited_ms = 0
    while host.controller.barrier_blocked():
        assert waited_ms < 2000, "each heartbeat reads the level"
        host.chip.rest(20)
        waited_ms += 20
    assert len(host.run()) == 6, "the next board is filmed"


def test_single_pulses(host: Host) -> None:
    for _ in range(3):
        host.controller.fire_one()
        pulse = host.next(PulseFired)  # only then is the next one possible
        assert (pulse.index, pulse.light) == (0, "top")
        assert host.next(RunEnded).reason == "single"
    assert len(host.chip.rises("PB1")) == 3
    host.controller.arm(PLAN)
    with pytest.raises(StateError, match="armed"):
        host.controller.fire_one()
    assert len(host.run()) == 6


def test_bounces_and_a_board_that_sticks(host: Host) -> None:
    host.controller.arm(PLAN)
    host.chip.board(2)
    bounce = host.next(BarrierBounce)
    assert bounce.duration_s == pytest.approx(0.002, abs=1e-4)
    host.chip.do("pin PB0 1")
    end = host.next(RunEnded)
    assert (end.pulses, end.reason) == (PLAN.max_rows, "max-rows")
    host.chip.do("pin PB0 0")
    host.chip.rest(20)
    assert len(host.run()) == 6


def test_a_reset_in_the_middle_of_a_run(host: Host) -> None:
    """What was fired is kept and named; the next board is filmed as ever, at times that are right."""
    host.controller.arm(PLAN)
    host.run()
    host.chip.do("pin PB0 1")
    while host.next(PulseFired).index != 2:
        pass
    host.chip.do("reset external 800")
    end = host.next(RunEnded)
    assert end.reason == "the controller was reset"
    assert end.pulses >= 3
    fault = host.next(DeviceFault)
    assert fault.error.code == "controller-reset"
    assert "its reset line was pulled" in str(fault.error)
    assert "the run under way was ended" in str(fault.error)
    host.chip.do("pin PB0 0")
    host.chip.rest(20)
    host.wait_ready()
    pulses = host.run()
    assert len(pulses) == 6
    assert host.clock.restarts == 1
    for pulse, cycle in zip(pulses, host.chip.rises("PB1")[-6:], strict=True):
        assert abs(host.clock.host_s(pulse.time_s) - host.chip.host_s(cycle)) <= host.clock.bound_s(pulse.time_s)


def test_a_hung_controller_is_reset_by_its_watchdog(host: Host) -> None:
    host.controller.arm(PLAN)
    host.chip.do("hang")
    assert "by its watchdog" in str(host.next(DeviceFault).error)
    host.wait_ready()
    assert len(host.run()) == 6


@pytest.mark.parametrize("while_away_ms", [300, 4000])
def test_a_port_that_goes_and_comes_back(host: Host, while_away_ms: int) -> None:
    """Up to the heartbeat's limit the controller goes on; after it, it switches all outputs off."""
    host.controller.arm(PLAN)
    host.run()
    host.chip.do("unplug")
    assert host.next(DeviceFault).error.code == "port-lost"
    with pytest.raises(DeviceError, match="serial port"):
        host.controller.arm(PLAN)
    with pytest.raises(DeviceError, match="serial port"):
        host.controller.read_clock()
    host.chip.board(100)
    host.chip.rest(while_away_ms)
    host.chip.do("plug")
    host.wait_ready()
    host.seen.clear()
    assert host.next(RunEnded).reason == "clear"  # of the board that passed meanwhile: its events were read again
    assert [p.index for p in host.pulses()] == list(range(6))
    assert len(host.run()) == 6
    assert ("controller-safe" in host.fault_codes()) == (while_away_ms > 3000)
    assert host.clock.restarts == 0


def test_disarmed_while_it_is_away(host: Host) -> None:
    host.controller.arm(PLAN)
    host.chip.do("unplug")
    host.next(DeviceFault)
    host.controller.disarm()
    host.chip.do("plug")
    host.wait_ready()
    host.controller.fire_one()
    assert host.next(RunEnded).reason == "single"


def test_noise_costs_time_and_nothing_else(host: Host) -> None:
    host.chip.do("noise 0.005 0.005 5")
    for _ in range(3):
        host.controller.arm(PLAN)
        rises = len(host.chip.rises("PB1"))
        pulses = host.run()
        assert [p.index for p in pulses] == list(range(6))
        assert len(host.chip.rises("PB1")) == rises + 6
        host.controller.disarm()
    host.chip.do("noise 0 0")
    assert "0 bad frames, 0 repeats" not in host.controller.health()


def test_a_host_that_was_stopped(paced: PacedChip) -> None:
    """SIGSTOP for longer than the heartbeat's limit: outputs off, a report, and armed again."""
    with armed_process(paced) as (process, lines):
        paced.board(60_000)
        while "PulseFired" not in next(lines):
            pass
        process.send_signal(signal.SIGSTOP)
        stopped = paced.do("pin PB0 1")
        paced.rest(4000)
        assert max(paced.rises("PB1")) < stopped + 3.5 * HZ
        paced.do("pin PB0 0")
        process.send_signal(signal.SIGCONT)
        line = ""
        while "DeviceFault" not in line:
            line = next(lines)
        assert "received no heartbeat from this computer" in line
        while "PulseFired" not in line:
            line = next(lines)
            if line == "nothing new\n":
                paced.board(100)


def test_events_of_an_earlier_process_are_not_reported(paced: PacedChip) -> None:
    """It was killed while armed: its events are not reported again, and no board is filmed for it."""
    with armed_process(paced) as (_, lines):
        paced.do("pin PB0 1")
        while "PulseFired" not in next(lines):
            pass
    second = Host(paced)
    try:
        paced.do("pin PB0 0")
        paced.rest(20)
        second.controller.arm(PLAN)
        assert len(second.run()) == 6
        assert not second.fault_codes()
    finally:
        second.controller.close()


def test_a_host_that_is_killed_lowers_line_ready_within_a_second(paced: PacedChip) -> None:
    """By the chip's clock: the last permit was sent before the kill, and is valid for one second at most."""
    with armed_process(paced) as (process, _):
        paced.wait(lambda: (PIN, 1) in [edge[1:] for edge in paced.edges])
        process.kill()
        process.wait()
        killed = paced.do("pin PD2 0")
        paced.wait(lambda: paced.edges[-1][1:] == (PIN, 0))
    assert paced.edges[-1][0] - killed < 1.01 * HZ


def test_a_light_program_on_the_firmware(host: Host) -> None:
    """What the firmware reports of every pulse is what the program has for its row."""
    rows = (ProgramRow("low", (250.0,), (0.0,), 60.0), ProgramRow("top", (250.0,), (0.0,), 120.5))
    host.controller.arm(replace(PLAN, program=rows, lights=("low", "top")))
    assert [(p.light, p.on_us) for p in host.run()] == [("low", 60.0), ("top", 120.5)] * 3


def test_exposures_by_the_width_of_the_trigger_on_the_firmware(host: Host) -> None:
    rows = tuple(ProgramRow("low", (us,), (0.0,), 60.0, us) for us in (250.0, 75.5))
    host.controller.arm(replace(PLAN, program=rows, lights=("low", "low"), by_trigger=(0,)))
    assert [(p.on_us, p.trigger_us) for p in host.run()] == [(60.0, 250.0), (60.0, 75.5)] * 3


def test_cameras_that_are_absent_leave_the_port_free(paced: PacedChip) -> None:
    """Whether or not Aravis is installed."""
    line = Line(
        conveyor_mm_s=(0.0, 100.0), barrier_mm=0.0, start_delay_s=0.1, trigger_period_s=0.1, tail_s=0.1,
        longest_board_mm=100.0,
    )  # fmt: skip
    left = {"name": "left", "backend": "aravis", "address": "127.0.0.99", "width": 64, "height": 64}
    controller = {"backend": "serial", "port": str(paced.link)}
    files = {"calibration": "calibration.json", "board_types": "types", "data": "data"}
    config = StationConfig.model_validate(
        {**files, "line": line, "cameras": [{**left, "exposure_us": 100.0}], "controller": controller}
    )
    with pytest.raises(DeviceError) as refused:
        open_devices(config)
    assert refused.value.action
    SerialController(ControllerConfig.model_validate(controller)).close()
