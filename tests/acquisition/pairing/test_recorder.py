"""Frames are assigned to pulses by time, and runs are settled."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.acquisition.recorder_script import PERIOD_S, RecorderScript
from vaoi_station.acquisition.clocks import ClockModel, ClockReading
from vaoi_station.acquisition.pairing.recorder import Finished, Outcome, assign_forced
from vaoi_station.model import Verdict


@given(st.data())
def test_assignments_are_right_and_independent_of_order(data: st.DataObject) -> None:
    truth = data.draw(st.lists(st.integers(0, 6), unique=True, max_size=7))
    sets = [{t, *data.draw(st.sets(st.integers(0, 6), max_size=3))} for t in truth]
    chosen = assign_forced(sets)
    assert all(truth[n] == c for n, c in chosen.items())
    turned = assign_forced(sets[::-1])
    assert {len(sets) - 1 - n: c for n, c in turned.items()} == chosen


fates = st.sampled_from(["ok"] * 6 + ["lost", "incomplete", "late", "twice"])
latencies = st.floats(0.001, 0.09)


@given(st.data())
def test_every_frame_is_in_its_row_and_every_camera_and_row_has_a_verdict(data: st.DataObject) -> None:
    script = RecorderScript(data.draw(st.integers(1, 3)))
    expected: dict[str, dict[tuple[int, int], str]] = {}
    first_s = 1000.5
    for number in range(data.draw(st.integers(1, 3))):
        rows, name = data.draw(st.integers(1, 6)), data.draw(st.sampled_from([f"run {number}"] * 4 + [None]))
        script.run(name, first_s, rows, data.draw(st.floats(0, 0.09)))
        expected_of = {(c, r): data.draw(fates) for c in range(script.cameras) for r in range(rows)}
        for (camera, row), fate in expected_of.items():
            exposed_s = first_s + row * PERIOD_S
            latency_s = data.draw(st.floats(0.1, 0.5)) if fate == "late" else data.draw(latencies)
            if fate != "lost":
                script.frame((name, camera, row), exposed_s, latency_s, complete=fate != "incomplete")
            if fate == "twice":
                script.frame((name, camera, row), exposed_s, latency_s + 0.01)
        for camera in range(script.cameras):
            for nth in data.draw(st.lists(st.integers(0, rows), max_size=2, unique=True)):
                off_s = data.draw(st.floats(0.012, PERIOD_S - 0.012))
                script.frame((name, camera, -1), first_s + (nth - 1) * PERIOD_S + off_s, data.draw(latencies))
        if name is not None:
            expected[name] = expected_of
        first_s += rows * PERIOD_S + data.draw(st.floats(0.05, 1.5))
    script.play()
    script.check()
    assert set(script.finished) == set(expected)
    for name, expected_of in expected.items():
        verdicts = script.verdicts(name)
        assert set(verdicts) == set(expected_of)
        for cell, fate in expected_of.items():
            if script.ambiguous(name, cell[0]):
                continue
            if fate in ("ok", "late", "twice"):
                assert verdicts[cell] is Verdict.OK
            else:
                assert verdicts[cell] in (
                    Verdict.MISSING,
                    Verdict.INCOMPLETE if fate == "incomplete" else verdicts[cell],
                )
                assert verdicts[cell] is not Verdict.OK


def test_a_clean_run_is_finished_with_its_last_frame() -> None:
    script = RecorderScript(2)
    script.run("a", 1000.0, 3, 0.001)
    for camera in range(2):
        for row in range(3):
            script.frame(("a", camera, row), 1000.0 + row * PERIOD_S, 0.02)
    script.play()
    script.check()
    assert set(script.verdicts("a").values()) == {Verdict.OK}
    (record,) = [o.record for o in script.outcomes if isinstance(o, Finished)]
    assert record.times_s() == pytest.approx((0.0, 0.1, 0.2), abs=1e-5)
    assert record.last_frame_host_s == pytest.approx(1000.22)
    assert record.unassigned == 0
    assert all(abs(f.pulse_error_us or 0) < 100 for f in script.finished["a"])


def test_a_frame_after_the_deadline_is_unassigned_and_its_row_missing() -> None:
    script = RecorderScript(1)
    script.run("a", 1000.0, 2, 0.0)
    script.frame(("a", 0, 0), 1000.0, 0.01)
    script.frame(("a", 0, 1), 1000.1, 1.5)
    script.play()
    script.check()
    assert script.verdicts("a")[0, 1] is Verdict.MISSING
    assert "which is finished" in script.unassigned[0].reason


def test_an_incomplete_frame_is_assigned_only_if_one_pulse_is_possible() -> None:
    script = RecorderScript(2)
    script.run("a", 1000.0, 3, 0.0)
    for camera, row in ((0, 0), (0, 2), (1, 0)):
        script.frame(("a", camera, row), 1000.0 + row * PERIOD_S, 0.02)
    script.frame(("a", 0, 1), 1000.1, 0.15, complete=False)
    script.frame(("a", 1, 2), 1000.2, 0.02, complete=False)
    script.play()
    script.check()
    verdicts = script.verdicts("a")
    assert verdicts[0, 1] is Verdict.INCOMPLETE
    assert {verdicts[1, 1], verdicts[1, 2]} == {Verdict.MISSING}, "it may be of row 1 or of row 2"
    assert "several pulses are possible" in script.unassigned[0].reason


def test_causality_may_leave_one_pulse_for_an_incomplete_frame() -> None:
    """Row 1 is missing too, but its pulse was fired after the incomplete frame had arrived."""
    script = RecorderScript(1)
    script.run("a", 1000.0, 3, 0.0)
    script.frame(("a", 0, 0), 1000.0, 0.02, complete=False)
    script.frame(("a", 0, 2), 1000.2, 0.02)
    script.play()
    script.check()
    assert script.verdicts("a") == {(0, 0): Verdict.INCOMPLETE, (0, 1): Verdict.MISSING, (0, 2): Verdict.OK}


def jumped_at_the_end(reading_s: float) -> RecorderScript:
    """A camera's clock jumps by 2 ms before the last frame; it is read at a host time. The other camera is sound."""
    script = RecorderScript(2)
    # The readings of the model end before the run, as in a station that reads every half second.
    script.recorder._camera_clocks = [ClockModel(f"camera {n}") for n in range(2)]
    for clock, true in zip(script.recorder._camera_clocks, script.camera_clocks, strict=True):
        for at_s in (999.0, 999.5, 1000.0):
            clock.add(ClockReading(true.device_s(at_s), at_s, 1e-5))
    script.run("a", 1000.1, 5, 0.001)
    for camera in range(2):
        for row in range(5):
            exposed_s = 1000.1 + row * PERIOD_S
            late_s = 0.002 if (camera, row) == (1, 4) else 0.0
            script.frame(("a", camera, row), exposed_s, 0.02, dated_s=exposed_s + late_s)

    def read(_now_s: float) -> tuple[Outcome, ...]:
        jump = script.recorder._camera_clocks[1].add(
            ClockReading(script.camera_clocks[1].device_s(reading_s) + 0.002, reading_s, 1e-5)
        )
        assert jump is not None
        script.recorder.outages.add_jump(1, jump)
        return tuple(script.recorder.settle(reading_s))

    script.at(reading_s, read)
    return script


def test_a_jump_at_the_end_of_a_run_is_named_as_soon_as_the_clock_is_read() -> None:
    script = jumped_at_the_end(1000.6)
    script.play()
    script.check()
    assert {(f.camera, f.kind) for f in script.proofs["a"].findings} == {(1, "clock-jumped")}
    assert {f.row for f in script.finished["a"] if f.usable and f.camera == 0} == set(range(5))
    assert script.recorder.open_runs == []


def test_clocks_are_wanted_from_the_last_pulse_to_the_end_of_the_run() -> None:
    script = RecorderScript(1)
    script.run("a", 1000.0, 2, 0.0)
    script.frame(("a", 0, 0), 1000.0, 0.02)
    script.frame(("a", 0, 1), 1000.1, 0.02)
    wanted = {}

    def look(now_s: float) -> tuple[Outcome, ...]:
        wanted[now_s] = script.recorder.awaits_clocks
        return ()

    for at_s in (1000.05, 1000.11, 1000.2):
        script.at(at_s, look)
    script.play()
    assert wanted == {1000.05: False, 1000.11: True, 1000.2: False}
