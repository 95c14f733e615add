"""The output "line ready" is switched for a person who measures, and ends low."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from tests.acquisition.controller.serial.fake_firmware import fake_firmware
from vaoi_station.acquisition.controller.protocol.messages import State
from vaoi_station.config import ControllerConfig
from vaoi_station.doctor.line_output import toggle_line_output
from vaoi_station.errors import DeviceError


def test_each_level_is_announced_and_the_last_is_low() -> None:
    shown: list[str] = []
    with fake_firmware() as (port, firmware):
        toggle_line_output(ControllerConfig(backend="serial", port=port), shown.append, times=2, level_s=0.01)
    assert [re.sub("[.].*", "", line) for line in shown] == [
        f"{k} of 2: line {word}" for k in (1, 2) for word in ("ready", "not ready")
    ]
    assert [bool(any(permit[2:])) for permit in firmware.permits][-2:] == [False, False]
    assert {permit[:2] for permit in firmware.permits} == {b"\0\0"}


def test_an_output_that_does_not_follow_is_reported() -> None:
    with fake_firmware() as (port, firmware):
        firmware.state = State.ARMED
        with pytest.raises(DeviceError, match="stays low") as stuck:
            toggle_line_output(ControllerConfig(backend="serial", port=port), lambda _: None, level_s=0.01)
    assert stuck.value.code == "interlock-stuck"


def test_firmware_without_the_output_is_named() -> None:
    with fake_firmware() as (port, firmware):
        firmware.ident = replace(firmware.ident, minor=1, ready_longest_ms=0)
        with pytest.raises(DeviceError, match="has no output 'line ready'"):
            toggle_line_output(ControllerConfig(backend="serial", port=port), lambda _: None)
