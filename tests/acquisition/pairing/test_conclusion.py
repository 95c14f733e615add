"""The end of a run: causes, outages, lights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest

from vaoi_station.acquisition.clocks import ClockJump
from vaoi_station.acquisition.controller.interface import PulseFired
from vaoi_station.acquisition.pairing.conclusion import (
    Outages,
    conclude_run,
    contradiction,
    judge_run,
)
from vaoi_station.acquisition.pairing.proof import TriggerProof
from vaoi_station.acquisition.pairing.run_record import ObservedFrame, ObservedPulse, RunRecord
from vaoi_station.model import FrameRecord, ProgramRow, Verdict


def test_an_outage_is_the_cause_from_its_begin_to_its_end() -> None:
    outages = Outages()
    outages.begin(1, 10.0, "no answer")
    assert outages.cause_at(1, 9.9) == ""
    assert outages.cause_at(1, 1e9) == "the camera was lost: no answer"
    assert outages.cause_at(0, 10.5) == ""
    outages.end(1, 12.0)
    outages.begin(1, 20.0, "unplugged")
    outages.end(1, 21.0)
    assert [outages.cause_at(1, s) for s in (11.0, 12.5, 20.5, 21.5)] == [
        "the camera was lost: no answer",
        "",
        "the camera was lost: unplugged",
        "",
    ]


LEFT = ProgramRow("left", (200.0, 200.0), (0.0, 6.0), 80.0)


def pulse(
    light: str,
    row: int = 0,
    on_us: float | None = None,
    exposures_us: tuple[float, ...] = (),
    gains: tuple[float, ...] = (),
) -> PulseFired:
    return PulseFired(0, float(row), row, light, exposures_us, gains, on_us)


@pytest.mark.parametrize(
    ("reported", "words"),
    [
        (pulse("left"), ""),
        (pulse("left", on_us=80.5, exposures_us=(80.0, 80.0), gains=(1.0, 1.9953)), ""),
        (pulse("right"), "its pulse was fired with light 'right', but the light program has 'left'"),
        (pulse(""), "its pulse was fired with no light, but the light program has 'left'"),
        (pulse("left", on_us=60.0), "light 'left' was on for 60 µs, but the light program has 80 µs"),
        (pulse("left", exposures_us=(80.0, 40.0)), "camera 1 had exposure 40 µs, but the light program has 80 µs"),
        (pulse("left", gains=(1.0, 1.0)), "camera 1 had gain 1, but the light program has 1.99526"),
    ],
)
def test_a_pulse_agrees_with_its_step_or_the_difference_is_stated(reported: PulseFired, words: str) -> None:
    assert contradiction(reported, LEFT) == words


PERIOD_S = 0.1
START_S = 100.0


def run_with_frames(ids: dict[int, int], rows: int = 6, name: str = "a", start_s: float = START_S) -> RunRecord:
    """Return a run of one camera: row → frame id of the frames that arrived."""
    run = RunRecord(name, 0, PERIOD_S, pulse_count=rows)
    for row in range(rows):
        pulse = PulseFired(0, start_s + row * PERIOD_S, row)
        run.pulses[row] = ObservedPulse(pulse, start_s + row * PERIOD_S, reported_s=start_s + row * PERIOD_S)
    for row, frame_id in ids.items():
        fired_s = run.pulses[row].host_s
        run.taken.add((0, row))
        run.complete_frames[0].append(ObservedFrame(row, frame_id, fired_s, fired_s, fired_s + 0.02))
        run.frames[0, row] = FrameRecord(camera=0, row=row, verdict=Verdict.OK, slot=row)
    return run


def concluded(
    run: RunRecord,
    unassigned: Sequence[Sequence[ObservedFrame]],
    outages: Outages,
    bound_s: float,
    previous: RunRecord | None = None,
) -> tuple[list[FrameRecord], TriggerProof]:
    missing, proof = judge_run(run, unassigned, outages, bound_s, previous)
    conclude_run(run, missing, proof)
    return missing, proof


def causes(run: RunRecord, outages: Outages | None = None, previous: RunRecord | None = None) -> dict[int, str]:
    missing, _ = concluded(run, [[]], outages or Outages(), 1e-4, previous)
    return {frame.row: frame.cause for frame in missing}


def test_a_refused_frame_precedes_an_outage_and_an_outage_precedes_the_ids() -> None:
    run, outages = run_with_frames({0: 1, 3: 4}, rows=4), Outages()
    run.refused[0, 1] = "its run has no free slot for row 1"
    outages.begin(0, START_S + 0.05, "no answer")
    outages.end(0, START_S + 0.25)
    assert causes(run, outages) == {
        1: "its run has no free slot for row 1",
        2: "the camera was lost: no answer",
    }


@pytest.mark.parametrize(("first_id", "cause"), [(7, "did not expose"), (9, "lost in transfer")])
def test_the_first_rows_are_compared_with_the_last_frame_of_the_run_before(first_id: int, cause: str) -> None:
    previous = run_with_frames({row: row + 1 for row in range(6)}, name="before", start_s=START_S - 2.0)
    run = run_with_frames({2: first_id, 3: first_id + 1}, rows=4)
    assert all(cause in text for text in causes(run, previous=previous).values())


def test_frames_of_the_time_in_which_a_clock_jumped_are_not_used() -> None:
    """Two readings of the clock enclose the jump; before and after it each frame is proven."""
    run, outages = run_with_frames({0: 1, 1: 2, 3: 4, 4: 5, 5: 6}), Outages()
    for k, frame in enumerate(run.complete_frames[0]):
        if frame.row in (4, 5):
            run.complete_frames[0][k] = replace(frame, time_s=frame.time_s - 1.0)
    outages.add_jump(0, ClockJump(-1.0, START_S + 0.15, START_S + 0.35))
    missing, proof = concluded(run, [[]], outages, 1e-4)
    assert [(frame.row, "its clock jumped by -1.00 s" in frame.cause) for frame in missing] == [(2, True)]
    assert [(f.row, f.kind) for f in proof.findings] == [(3, "clock-jumped")]
    assert (proof.proven, proof.cameras[0].proven) == (False, False)
    assert {row for (_, row), frame in run.frames.items() if frame.usable} == {0, 1, 4, 5}


def test_a_camera_whose_clock_jumped_by_one_period_does_not_run_freely() -> None:
    """The frames of rows 2 and 3 took rows 3 and 4, so the next one, dated correctly again, found its row taken."""
    run, outages = run_with_frames({0: 1, 1: 2, 3: 3, 4: 4, 5: 6, 6: 7, 7: 8}, rows=8), Outages()
    for k, frame in enumerate(run.complete_frames[0]):
        if frame.row in (3, 4):
            run.complete_frames[0][k] = replace(frame, arrived_s=frame.arrived_s - PERIOD_S)
    outages.add_jump(0, ClockJump(PERIOD_S, START_S - 0.1, START_S + 0.35))
    displaced = ObservedFrame(None, 5, START_S + 0.4, START_S + 0.4, START_S + 0.42)
    missing, proof = concluded(run, [[displaced]], outages, 1e-4)
    assert {frame.row for frame in missing} == {2}
    assert [(f.row, f.kind) for f in proof.findings] == [(row, "clock-jumped") for row in (0, 1, 3, 4)]
    assert {row for (_, row), frame in run.frames.items() if frame.usable} == {5, 6, 7}


def test_a_frame_of_another_light_than_the_program_has_is_not_proven() -> None:
    run = run_with_frames({0: 1, 1: 2, 2: 3}, rows=3)
    run.program = (ProgramRow("", (100.0,), (0.0,)), ProgramRow("left", (100.0,), (0.0,)))
    _, proof = concluded(run, [[]], Outages(), 1e-4)
    assert [(f.kind, f.row) for f in proof.findings] == [("other-light", 1)]
    assert not proof.proven
    assert [run.frames[0, row].proven for row in range(3)] == [True, False, True]
    assert "the light program has 'left'" in run.frames[0, 1].cause
