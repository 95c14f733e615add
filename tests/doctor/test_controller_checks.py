"""Judge the controller without a device; the output "line ready"."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.acquisition.controller.serial.fake_firmware import fake_firmware
from tests.doctor.conftest import assert_problem, changed, only
from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.acquisition.controller.protocol import Fault, Ident, State, Status
from vaoi_station.config import ControllerConfig, LightConfig, StationConfig
from vaoi_station.doctor import controller_checks
from vaoi_station.doctor.controller_checks import toggle_line_output
from vaoi_station.doctor.finding import Level
from vaoi_station.doctor.machine import Machine
from vaoi_station.doctor.running_station import CheckContext, RunningProcess

IDENT = Ident.unpack(bytes(Ident.LAYOUT.size))


def test_controller_of_a_running_station_is_reported_by_it(config: StationConfig) -> None:
    known = CheckContext(config, Machine(), RunningProcess(4711, {"state": "idle", "controller": "armed"}))
    assert only(controller_checks.controller(known)).message == "armed"
    unknown = CheckContext(config, Machine(), RunningProcess(4711, {"state": "starting"}))
    assert only(controller_checks.controller(unknown)).level is Level.OK


@pytest.mark.parametrize(("cause", "checks_leds"), [(Fault.HEARTBEAT, False), (Fault.GUARD, True)])
def test_a_controller_in_its_safe_state_says_what_to_check_first(cause: Fault, checks_leds: bool) -> None:
    status = replace(Status.unpack(bytes(Status.LAYOUT.size)), state=State.SAFE, fault=cause)
    finding = controller_checks.judge_status(status)
    assert (finding.code, finding.level) == ("controller-safe", Level.WARNING)
    assert ("LED drivers" in finding.action) is checks_leds
    assert finding.action.endswith("Start the station, which disarms it.")


@pytest.mark.parametrize(("delay", "count"), [("16", 1), ("2", 1), ("1", 0), (None, 0)])
def test_delay_of_the_usb_bridge(tmp_path: Path, delay: str | None, count: int) -> None:
    entry = tmp_path / controller_checks.LATENCY.format(name="ttyUSB0")
    if delay is not None:
        entry.parent.mkdir(parents=True)
        entry.write_text(delay)
    findings = list(controller_checks.judge_latency(Path("/nowhere/ttyUSB0"), Machine(tmp_path)))
    assert len(findings) == count
    if delay is not None and count:
        assert_problem(findings[0], Level.WARNING, f"{delay} ms", "limit: 1 ms")


def test_lights_within_the_limits_are_ok_and_others_are_a_fault(config: StationConfig) -> None:
    limits: dict[str, Any] = {"led_longest_0": 2000, "led_shortest": 2, "led_bucket": 60000, "led_duty_shift": 4}
    ident = replace(IDENT, channels=1, program_steps=8, tick_ns=500, **limits)
    assert "no lights are configured" in controller_checks.judge_limits(ident, config).message
    long = changed(config, "controller", lights={"flash": LightConfig(channels=(0,), on_us=1001.0)})
    assert_problem(controller_checks.judge_limits(ident, long), Level.FAULT, "controller.lights.flash.on_us is 1001")


@pytest.mark.parametrize(
    ("bound_s", "period_s", "words"),
    [(3e-3, 0.125, "trigger period is 2 ms"), (1e-3, 0.006, "trigger period is 0.6 ms"), (1e-3, 0.125, "")],
)
def test_clock_bound_is_judged_by_the_trigger_period(bound_s: float, period_s: float, words: str) -> None:
    finding = controller_checks.judge_clock([ClockReading(0.0, 10.0, bound_s)], period_s)
    assert finding.figures["bound_ms"] == pytest.approx(bound_s * 1e3)
    if words:
        assert_problem(finding, Level.FAULT, words)
    else:
        assert finding.level is Level.OK


def test_each_level_is_announced_and_the_last_is_low() -> None:
    shown: list[str] = []
    with fake_firmware() as (port, firmware):
        toggle_line_output(ControllerConfig(backend="serial", port=port), shown.append, times=2, level_s=0.01)
    assert [re.sub("[.].*", "", line) for line in shown] == [
        f"{k} of 2: line {word}" for k in (1, 2) for word in ("ready", "not ready")
    ]
    assert [bool(any(permit[2:])) for permit in firmware.permits][-2:] == [False, False]
    assert {permit[:2] for permit in firmware.permits} == {b"\0\0"}
