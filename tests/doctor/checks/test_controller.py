"""Judge port, firmware, limits, state and clock of the controller without a device."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.doctor.conftest import assert_problem, changed, only, with_config
from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.acquisition.controller.protocol.messages import Fault, Ident, State, Status
from vaoi_station.config import LightConfig, StationConfig
from vaoi_station.doctor.check_context import CheckContext, RunningProcess
from vaoi_station.doctor.checks import controller
from vaoi_station.doctor.finding import Level
from vaoi_station.doctor.machine import Machine

IDENT = Ident.unpack(bytes(Ident.LAYOUT.size))
STATUS = Status.unpack(bytes(Status.LAYOUT.size))


def status(state: State, **fields: int) -> Status:
    """Return a status report in a given state."""
    return replace(STATUS, state=state, **fields)


def test_simulated_controller_is_not_checked(context: CheckContext) -> None:
    assert only(controller.controller(context)).level is Level.NOT_APPLICABLE


def test_controller_of_a_running_station_is_reported_by_it(config: StationConfig) -> None:
    known = CheckContext(config, Machine(), RunningProcess(4711, {"state": "idle", "controller": "armed"}))
    assert only(controller.controller(known)).message == "armed"
    unknown = CheckContext(config, Machine(), RunningProcess(4711, {"state": "starting"}))
    assert only(controller.controller(unknown)).level is Level.OK


def test_absent_port_ends_the_check(context: CheckContext, tmp_path: Path) -> None:
    config = changed(context.config, "controller", backend="serial", port=str(tmp_path / "gone"))
    assert_problem(only(controller.controller(with_config(context, config))), Level.FAULT, "there is no", "gone")


def test_absent_port_lists_the_serial_devices(tmp_path: Path) -> None:
    (tmp_path / "dev/serial/by-id").mkdir(parents=True)
    (tmp_path / "dev/serial/by-id/usb-FTDI").write_text("")
    assert_problem(controller.judge_port(tmp_path / "gone", Machine(tmp_path)), Level.FAULT, "usb-FTDI")


def test_file_is_no_serial_port(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert_problem(controller.judge_port(tmp_path / "file", Machine()), Level.FAULT, "is no serial port")


def test_free_terminal_is_ok() -> None:
    ours, theirs = os.openpty()
    try:
        assert controller.judge_port(Path(os.ttyname(theirs)), Machine()).level is Level.OK
    finally:
        os.close(ours)
        os.close(theirs)


@pytest.mark.parametrize(("delay", "count"), [("16", 1), ("2", 1), ("1", 0), (None, 0)])
def test_delay_of_the_usb_bridge(tmp_path: Path, delay: str | None, count: int) -> None:
    entry = tmp_path / controller.LATENCY.format(name="ttyUSB0")
    if delay is not None:
        entry.parent.mkdir(parents=True)
        entry.write_text(delay)
    findings = list(controller.judge_latency(Path("/nowhere/ttyUSB0"), Machine(tmp_path)))
    assert len(findings) == count
    if delay is not None and count:
        assert_problem(findings[0], Level.WARNING, f"{delay} ms", "limit: 1 ms")


def test_firmware_is_described() -> None:
    ident = replace(IDENT, major=1, firmware_major=1, firmware_minor=2, firmware_patch=3, boots=9, unit=7)
    finding = controller.judge_firmware(replace(ident, build=b"f8e2a4c\0"))
    assert finding.message == "version 1.2.3 (f8e2a4c), protocol 1.0, unit 7, start number 9"
    erased = controller.judge_firmware(replace(ident, unit=0xFFFFFFFF))
    assert "no unit number" in erased.message
    assert erased.figures["unit"] is None


def test_lights_within_the_limits_are_ok_and_others_are_a_fault(config: StationConfig) -> None:
    limits: dict[str, Any] = {"led_longest_0": 2000, "led_shortest": 2, "led_bucket": 60000, "led_duty_shift": 4}
    ident = replace(IDENT, channels=1, program_steps=8, tick_ns=500, **limits)
    assert "no lights are configured" in controller.judge_limits(ident, config).message
    long = changed(config, "controller", lights={"flash": LightConfig(channels=(0,), on_us=1001.0)})
    assert_problem(controller.judge_limits(ident, long), Level.FAULT, "controller.lights.flash.on_us is 1001")


def test_states() -> None:
    idle = controller.judge_status(status(State.IDLE, blocked=1))
    assert (idle.level, idle.message) == (Level.OK, "idle, the light barrier is interrupted")
    safe = controller.judge_status(status(State.SAFE, fault=Fault.HEARTBEAT))
    assert_problem(safe, Level.WARNING, "safe state (heartbeat)")
    armed = controller.judge_status(status(State.ARMED))
    assert_problem(armed, Level.WARNING, "no station runs here")


@pytest.mark.parametrize(
    ("bound_s", "period_s", "words"),
    [(3e-3, 0.125, "trigger period is 2 ms"), (1e-3, 0.006, "trigger period is 0.6 ms"), (1e-3, 0.125, "")],
)
def test_clock_bound_is_judged_by_the_trigger_period(bound_s: float, period_s: float, words: str) -> None:
    finding = controller.judge_clock([ClockReading(0.0, 10.0, bound_s)], period_s)
    assert finding.figures["bound_ms"] == pytest.approx(bound_s * 1e3)
    if words:
        assert_problem(finding, Level.FAULT, words)
    else:
        assert finding.level is Level.OK


def test_an_interlock_needs_firmware_with_its_output() -> None:
    assert controller.judge_interlock(replace(IDENT, ready_longest_ms=1000)).level is Level.OK
    assert controller.judge_interlock(replace(IDENT, ready_longest_ms=0)).level is Level.FAULT
