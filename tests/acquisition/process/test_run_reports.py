"""Tests of the reports of finished runs and of faults."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from vaoi_station.acquisition.clocks import ClockJump
from vaoi_station.acquisition.controller.interface import PulseFired
from vaoi_station.acquisition.pairing.proof import TriggerProof
from vaoi_station.acquisition.pairing.recorder import Finished
from vaoi_station.acquisition.pairing.run_record import ObservedPulse, RunRecord
from vaoi_station.acquisition.process.run_reports import clock_jump_error, finished_report, trouble_report
from vaoi_station.config import StationConfig
from vaoi_station.model import FrameRecord, Verdict

PROOF = TriggerProof(proven=True, cameras=(), findings=())


def finished(last_frame_s: float | None) -> Finished:
    record = RunRecord("r1", 1, 0.05, pulse_count=2, reason="clear", unassigned=3, last_frame_host_s=last_frame_s)
    for row in range(2):
        record.pulses[row] = ObservedPulse(PulseFired(0, 7.0 + row * 0.05, row), 100.0 + row * 0.05)
    frames = tuple(
        FrameRecord(camera=camera, row=row, verdict=verdict, cause="" if verdict is Verdict.OK else "lost", slot=slot)
        for camera, row, verdict, slot in (
            (0, 0, Verdict.OK, 0), (0, 1, Verdict.INCOMPLETE, 1), (1, 0, Verdict.OK, 4), (1, 1, Verdict.MISSING, None),
        )
    )  # fmt: skip
    return Finished(record, frames, PROOF)


def test_reports_that_contradict_each_other_cost_the_run_its_certainty_not_the_process(
    make_config: Callable[..., StationConfig],
) -> None:
    """A controller that was reset meanwhile may report a row earlier than the row before."""
    run = finished(100.2)
    run.record.pulses[1] = ObservedPulse(PulseFired(0, 0.5, 1), 100.05)
    head = finished_report(make_config(), run, 101.0).head
    assert (head.rows, head.missing, head.trigger_times_s) == (2, ((0, 1), (1, 1)), None)
    assert [("contradict" in doubt, "must increase" in doubt) for doubt in head.doubts] == [(True, True)]


@pytest.mark.parametrize(("now_s", "expected_s"), [(101.0, 100.05), (100.01, 100.01)])
def test_without_a_frame_the_last_pulse_dates_the_run_but_never_the_future(
    make_config: Callable[..., StationConfig], now_s: float, expected_s: float
) -> None:
    report = finished_report(make_config(), finished(None), now_s)
    assert report.last_frame_host_s == pytest.approx(expected_s)


@pytest.mark.parametrize(("configured", "written"), [(0, None), (270, 270)])
def test_the_head_states_the_rotation_of_boards_on_this_line(
    make_config: Callable[..., StationConfig], configured: int, written: int | None
) -> None:
    config = make_config()
    expected = config.line.expected_board.model_copy(update={"rotation_deg": configured})
    turned = config.model_copy(update={"line": config.line.model_copy(update={"expected_board": expected})})
    assert finished_report(turned, finished(None), 101.0).head.rotation_deg == written


def test_a_clock_jump_names_the_camera_its_cost_and_what_to_do() -> None:
    report = trouble_report(clock_jump_error("camera c0", ClockJump(37.0, 10.0, 10.5)))
    assert report.message == (
        "camera c0: its clock jumped by +37.00 s; frames of the 0.5 s before it was noticed are not used."
    )
    assert (report.code, "PTP" in report.action) == ("clock-jumped", True)
