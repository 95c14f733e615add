"""Judge the camera library, what cameras offer, network ports, and the state that a running station reports."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from tests.doctor.conftest import assert_problem, only
from vaoi_station.acquisition.cameras.aravis.network import PacketLimits
from vaoi_station.config import CameraConfig, StationConfig
from vaoi_station.doctor import camera_checks
from vaoi_station.doctor.finding import Level
from vaoi_station.doctor.machine import Machine
from vaoi_station.doctor.running_station import CheckContext, RunningProcess


@pytest.mark.parametrize(
    ("version", "perhaps_usb", "level"),
    [((0, 8, 26), 0, Level.OK), ((0, 8, 26), 1, Level.WARNING), ((0, 8, 30), 1, Level.OK), ((0, 9, 1), 2, Level.OK)],
)
def test_versions_of_aravis(version: tuple[int, int, int], perhaps_usb: int, level: Level) -> None:
    finding = camera_checks.judge_version(version, "3.42.2", perhaps_usb)
    assert finding.level is level
    if level is Level.WARNING:
        assert_problem(finding, level, "unreliable with USB3")


OFFERED = camera_checks.Offered(
    vendor="Maker", model="M", serial="1", triggers=("FrameStart",), sources=("Line0", "Line1"),
    formats=("Mono8", "Mono12"), exposure_us=(10.0, 1e6), sensor=(2048, 1536), trigger_mode="Off", port="lo",
    address="127.0.0.1", packets=PacketLimits(smallest=200, largest=16000, step=4),
    without=("SequencerMode",),
)  # fmt: skip


def configured(**fields: Any) -> CameraConfig:
    """Return the configuration of one small camera."""
    given = {"name": "a", "backend": "aravis", "address": "127.0.0.1", "exposure_us": 100.0, "trigger_line": "Line1"}
    return CameraConfig.model_validate({**given, "width": 64, "height": 64, **fields})


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"trigger_line": "Line7"}, "has no trigger input Line7; it has Line0, Line1"),
        ({"pixel_format": "Mono16"}, "has no pixel format Mono16; it has Mono8, Mono12"),
        ({"exposure_by": "trigger-width"}, "for the width of the trigger, as exposure_by states: it has none."),
        ({"exposure_by": "sequencer"}, "has no sequencer, as exposure_by states: SequencerMode missing."),
        ({"ptp": True}, "has no PTP, as ptp = true states."),
        ({"exposure_us": 5.0}, "cannot expose for 5 µs; its range is 10 … 1e+06 µs"),
        (
            {"width": 2000, "offset_px": (100, 0)},
            "a sensor of 2048×1536 px, but the configured frame ends at column 2100",
        ),
        ({"height": 1536, "offset_px": (0, 1)}, "row 1537"),
    ],
)
def test_every_unmet_requirement_is_a_fault(fields: dict[str, Any], words: str) -> None:
    assert_problem(only(camera_checks.judge_camera(configured(**fields), OFFERED)), Level.FAULT, words)


def test_a_link_that_fell_back_to_100_mbit_is_a_warning_and_a_row_that_does_not_fit_a_fault() -> None:
    slow = replace(OFFERED, speed_mbit_s=100.0)
    found = list(camera_checks.judge_camera(configured(), slow))
    assert_problem(found[-1], Level.WARNING, "has a link of 100 Mbit/s only")
    wide = configured(width=1920, height=1200)
    finding = camera_checks.judge_port("lo", [(wide, slow)], 0.1)
    assert_problem(finding, Level.FAULT, "the cameras themselves need 186.5 ms for a row at 100 Mbit/s")


def test_what_another_program_left_is_told_and_no_fault() -> None:
    left = ("LUTEnable[LUT1] from True to False (else grey levels would pass a look-up table)",)
    good, told = camera_checks.judge_camera(configured(), replace(OFFERED, left=left, black_level=16.0))
    assert (good.level, good.figures["black_level"]) == (Level.OK, 16.0)
    assert (told.level, told.figures["left_over"]) == (Level.OK, 1)
    assert "what another program left in it: LUTEnable[LUT1] from True to False" in told.message


def test_packets_that_a_switch_drops_are_a_warning() -> None:
    dropped = replace(OFFERED, passing=1500)
    finding = camera_checks.judge_port("lo", [(configured(), dropped), (configured(name="b"), OFFERED)], 0.1)
    assert_problem(finding, Level.WARNING, "packets of 1500 bytes (by the MTU alone: no test packets from b)")
    assert "larger ones are dropped on the way" in finding.message


def test_packets_larger_than_the_camera_sends_are_a_warning() -> None:
    """The interface takes such packets; a larger MTU would not help."""
    finding = camera_checks.judge_port("lo", [(configured(packet_bytes=40000), OFFERED)], 0.1)
    assert_problem(finding, Level.WARNING, "a is configured for 40000")
    assert finding.action.startswith("Set packet_bytes to 16000")


def test_state_of_cameras_of_a_running_station(config: StationConfig) -> None:
    snapshot = {
        "cameras": [
            {"name": "left", "connected": False, "message": "camera left: not open yet"},
            {"name": "right", "connected": True, "message": "", "delivered": 7, "incomplete": 1},
            {"name": "third", "connected": True, "message": "is hot"},
        ],
    }
    left, right, third = camera_checks.cameras(CheckContext(config, Machine(), RunningProcess(4711, snapshot)))
    assert_problem(left, Level.FAULT, "is not connected: not open yet")
    assert (right.level, right.figures["delivered"]) == (Level.OK, 7)
    assert_problem(third, Level.WARNING, "is hot")
