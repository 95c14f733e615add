"""The latency of a camera, and how runs teach it."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from tests.acquisition.recorder_script import PERIOD_S, RecorderScript
from vaoi_station.acquisition.controller.interface import PulseFired
from vaoi_station.acquisition.pairing.evidence import GATE_S
from vaoi_station.acquisition.pairing.latency import (
    Beginning,
    Latencies,
    LatencySettings,
    learn,
)
from vaoi_station.acquisition.pairing.proof import doubts_of
from vaoi_station.acquisition.pairing.run_record import ObservedPulse, RunRecord
from vaoi_station.model import Verdict

T = 0.03
PULSES_S = [10.0 + k * T for k in range(5)]
BOUND_S = 1e-4


def beginning(latency_s: float, rows: list[int], *, pulses: int = 5, silent: bool = True) -> Beginning:
    frames_s = [PULSES_S[0] + row * T + latency_s for row in rows]
    return Beginning(PULSES_S[:pulses], frames_s, T, BOUND_S, silent)


def learnt(begun: Beginning, expected_s: float = 0.0) -> tuple[object, bool]:
    found = learn(begun, expected_s, GATE_S)
    assert found is not None
    return found


@pytest.mark.parametrize("latency_ms", [12, 28])
def test_three_frames_of_the_first_pulses_confirm_any_latency_below_the_period(latency_ms: float) -> None:
    assert learn(beginning(latency_ms / 1e3, [0, 1]), 0.0, GATE_S) is None
    assert learnt(beginning(latency_ms / 1e3, [0, 1, 2]), 0.0) == (pytest.approx(latency_ms / 1e3), True)


@pytest.mark.parametrize("latency_ms", [29.95, 58])
def test_beyond_the_period_the_count_of_frames_decides_at_the_end(latency_ms: float) -> None:
    early = beginning(latency_ms / 1e3, [0, 1, 2, 3])
    assert learn(early, 0.0, GATE_S) is None
    assert learnt(replace(beginning(latency_ms / 1e3, [0, 1, 2, 3, 4]), all_fired=True), 0.0) == (
        pytest.approx(latency_ms / 1e3),
        True,
    )


def test_a_single_frame_far_from_the_expected_latency_confirms_nothing() -> None:
    """It may be an extra exposure whose frame arrived before that of the pulse."""
    single = replace(Beginning(PULSES_S[:1], [10.02], T, BOUND_S, True), all_fired=True)
    assert learn(single, 0.0, GATE_S) is None
    assert learnt(replace(single, overdue=True), 0.0) == (pytest.approx(0.02), False)
    assert learnt(single, 0.02) == (pytest.approx(0.02), True)


def test_without_the_first_frame_the_shortest_latency_is_assumed_and_not_confirmed() -> None:
    """The frames of rows 1, 2, … at 28 ms could be those of rows 0, 1, … at 58 ms."""
    early = beginning(0.028, [1, 2, 3, 4])
    assert learn(early, 0.0, GATE_S) is None
    assert learnt(replace(early, overdue=True), 0.0) == (pytest.approx(0.028), False)


def test_jitter_at_the_edge_of_the_error_bound_is_not_several_frames_for_one_pulse() -> None:
    """With clocks read on a busy computer the bound reaches the rest of the period; one frame came for every pulse."""
    rest_s = 0.002
    frames_s = [p + T - rest_s + e for p, e in zip(PULSES_S[:3], (0.0, 5e-6, -5e-6), strict=True)]
    begun = Beginning(PULSES_S[:4], frames_s, T, rest_s, True)
    assert learn(begun, 0.0, GATE_S) is None
    complete = replace(begun, pulses_s=PULSES_S[:3], all_fired=True)
    assert learnt(complete) == (pytest.approx(T - rest_s), True)


START_S = 1000.0


def film(script: RecorderScript, run: str, start_s: float, latency_s: float, rows: list[int], *, of: int = 6) -> None:
    """Schedule a run of one camera whose time stamps are late; `rows` are those of which a frame arrives."""
    script.run(run, start_s, of, 0.001)
    for row in range(of):
        exposed_s = start_s + row * PERIOD_S
        if row in rows:
            arrives_s = 0.01 + latency_s
            script.frame((run, 0, row), exposed_s, arrives_s, dated_s=exposed_s + latency_s)
        else:
            script.skip_id(0)


@pytest.mark.parametrize("latency_s", [0.0, 0.098, PERIOD_S, 1.3 * PERIOD_S])
def test_every_latency_is_learnt_from_the_first_run(latency_s: float) -> None:
    """98 ms at a period of 100 ms looks like 2 ms before the next pulse, which is impossible."""
    script = RecorderScript(1)
    for number, name in enumerate("ab"):
        film(script, name, START_S + 3.0 * number, latency_s, list(range(6)))
    script.play()
    script.check()
    for name in "ab":
        assert set(script.verdicts(name).values()) == {Verdict.OK}
        assert script.proofs[name].proven
        assert not script.proofs[name].findings
        assert script.proofs[name].cameras[0].latency_us == pytest.approx(latency_s * 1e6 + 7, abs=100)


def test_without_a_frame_of_the_first_pulse_the_run_is_in_doubt_and_the_next_one_is_not() -> None:
    script = RecorderScript(1)
    film(script, "a", START_S, 0.028, [1, 2, 3, 4, 5])
    film(script, "b", START_S + 3.0, 0.028, list(range(6)))
    film(script, "c", START_S + 6.0, 0.028, [1, 2, 3, 4, 5])
    script.play()
    script.check()
    assert [f.kind for f in script.proofs["a"].findings] == ["latency-ambiguous"]
    assert "camera 0" in doubts_of(script.proofs["a"])[0]
    assert not script.proofs["b"].findings
    assert not script.proofs["c"].findings, "once confirmed, a lost first frame leaves no doubt"


def test_a_belt_faster_than_planned_confirms_no_latency_that_is_one_pulse_off() -> None:
    """The frame of the first pulse is lost; the others seem to follow the pulses by 0.82 trigger periods."""
    latencies, run = Latencies([LatencySettings()], lambda _camera, _s: 1e-4), RunRecord("a", 0, PERIOD_S)
    for row in range(4):
        fired_s = START_S + row * 0.8 * PERIOD_S
        run.pulses[row] = ObservedPulse(PulseFired(0, fired_s, row), fired_s)
    waiting = [(run.pulses[row].host_s + 0.002, False) for row in (1, 2, 3)]
    latencies.learn(0, [run], waiting, [], START_S + 1)
    assert not latencies[0].confirmed
    assert run.latency_known == {}


def test_a_latency_that_grows_by_nearly_a_period_is_named_and_used_from_the_next_run_on() -> None:
    script = RecorderScript(1)
    film(script, "a", START_S, 0.0, list(range(6)))
    film(script, "b", START_S + 3.0, 0.098, list(range(6)))
    film(script, "c", START_S + 6.0, 0.098, list(range(6)))
    script.play()
    script.check_slots()
    assert [f.kind for f in script.proofs["b"].findings] == ["latency-changed"]
    assert "98.0 ms after the pulses" in script.proofs["b"].findings[0].text
    assert not script.wrong_rows("b")
    assert not script.proofs["c"].findings
    assert set(script.verdicts("c").values()) == {Verdict.OK}


@pytest.mark.parametrize(
    ("latency_s", "found"), [(0.0, []), (0.098, ["latency-changed"]), (PERIOD_S, ["latency-changed"])]
)
def test_frames_taken_before_the_latency_came_into_doubt_count_as_well(latency_s: float, found: list[str]) -> None:
    """Run b waits for its frames until the first ones of run c were taken; its own frames put the latency in doubt."""
    script = RecorderScript(1)
    film(script, "a", START_S, 0.0, list(range(6)))
    film(script, "b", START_S + 3.0, 0.0, [])
    for number in range(4):
        stray_s = START_S + 3.03 + number * PERIOD_S
        script.frame(("b", 0, -1), stray_s, 0.02)
    film(script, "c", START_S + 3.0 + 5 * PERIOD_S + 0.35, latency_s, list(range(6)))
    script.play()
    assert [f.kind for f in script.proofs["c"].findings] == found
    assert bool(script.wrong_rows("c")) <= bool(found)


def test_a_wrong_given_latency_is_named() -> None:
    script = RecorderScript(1, [LatencySettings(given_s=0.0)])
    film(script, "a", START_S, 0.098, list(range(6)))
    script.play()
    assert [f.kind for f in script.proofs["a"].findings] == ["latency-changed"]
    assert not script.wrong_rows("a")


fates = st.sampled_from(["ok"] * 6 + ["lost", "ignored", "incomplete", "extra"])


@settings(max_examples=300)
@given(st.data())
def test_no_frame_is_accepted_in_a_wrong_row_without_a_doubt(data: st.DataObject) -> None:
    """The latency may be anything below the period, and may change between runs."""
    script = RecorderScript(1)
    start_s, latency_s = START_S, data.draw(st.floats(0, 0.999 * PERIOD_S))
    names = [f"run {n}" for n in range(data.draw(st.integers(1, 3)))]
    complete: dict[str, bool] = {}
    for name in names:
        jump = data.draw(st.sampled_from([0.0] * 4 + [0.3, 0.5, 0.95]))
        latency_s = (latency_s + jump * PERIOD_S) % (0.999 * PERIOD_S)
        rows = data.draw(st.lists(fates, min_size=3, max_size=8))
        script.run(name, start_s, len(rows), data.draw(st.floats(0, 0.05)))
        complete[name] = not jump and set(rows) == {"ok"}
        for row, fate in enumerate(rows):
            exposed_s = start_s + row * PERIOD_S
            arrives_s = latency_s + data.draw(st.floats(0.001, 0.02))
            if fate == "lost":
                script.skip_id(0)
            elif fate != "ignored":
                whole = fate != "incomplete"
                script.frame((name, 0, row), exposed_s, arrives_s, complete=whole, dated_s=exposed_s + latency_s)
            if fate == "extra":
                off_s = data.draw(st.floats(0.2, 0.8)) * PERIOD_S
                script.frame((name, 0, -1), exposed_s + off_s, arrives_s, dated_s=exposed_s + off_s + latency_s)
        start_s += len(rows) * PERIOD_S + data.draw(st.floats(0.5, 2.0))
    script.play()
    script.check_slots()
    for name in names:
        if script.wrong_rows(name):
            event("in a wrong row, with a doubt")
            assert doubts_of(script.proofs[name])
        if complete[name] and name == names[0]:
            assert not script.proofs[name].findings
            assert set(script.verdicts(name).values()) == {Verdict.OK}
