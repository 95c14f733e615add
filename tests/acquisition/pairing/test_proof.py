"""The proof of a run, and the doubts that it leaves."""

from __future__ import annotations

import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from tests.acquisition.recorder_script import PERIOD_S, RecorderScript
from vaoi_station.acquisition.pairing.proof import (
    QUESTIONING_KINDS,
    Kind,
    TriggerFinding,
    TriggerProof,
    doubts_of,
)
from vaoi_station.model import Verdict

START_S = 1000.0
ROWS = 8


def at_s(row: int) -> float:
    return START_S + row * PERIOD_S


def film_rows(script: RecorderScript, camera: int, rows: range | list[int]) -> None:
    for row in rows:
        script.frame(("a", camera, row), at_s(row), 0.02)


def proof_of(script: RecorderScript) -> TriggerProof:
    script.play()
    script.check_slots()
    return script.proofs["a"]


def kinds_found(proof: TriggerProof) -> list[tuple[int, int | None, str]]:
    return [(f.camera, f.row, f.kind) for f in proof.findings]


@pytest.fixture
def script() -> RecorderScript:
    """Two cameras, one run; camera 1 does what it should."""
    script = RecorderScript(2)
    script.run("a", START_S, ROWS, 0.001)
    film_rows(script, 1, range(ROWS))
    return script


def test_a_run_without_faults_is_proven_with_its_figures(script: RecorderScript) -> None:
    film_rows(script, 0, range(ROWS))
    proof = proof_of(script)
    assert proof.proven
    assert proof.findings == ()
    for camera in proof.cameras:
        assert (camera.pulses, camera.frames, camera.extra) == (ROWS, ROWS, 0)
        assert camera.max_residual_us is not None
        assert camera.max_residual_us < 1
        assert camera.latency_us == pytest.approx(7, abs=100)


def test_frames_lost_in_transfer_leave_the_others_proven(script: RecorderScript) -> None:
    for row in range(ROWS):
        if row in (2, 3):
            script.skip_id(0)
        else:
            script.frame(("a", 0, row), at_s(row), 0.02)
    proof = proof_of(script)
    assert proof.proven
    assert proof.findings == ()
    assert proof.cameras[0].frames == ROWS - 2


@pytest.mark.parametrize("ignored", [True, False])
def test_the_first_rows_are_explained_by_the_run_before(script: RecorderScript, ignored: bool) -> None:
    """The camera continues to count from the last frame of that run."""
    film_rows(script, 0, range(ROWS))
    start_s = at_s(ROWS) + 2.0
    script.run("b", start_s, 4, 0.001)
    if not ignored:
        script.skip_id(0), script.skip_id(0)
    for camera, rows in ((0, (2, 3)), (1, range(4))):
        for row in rows:
            script.frame(("b", camera, row), start_s + row * PERIOD_S, 0.02)
    script.play()
    script.check_slots()
    assert script.proofs["b"].proven
    kinds = kinds_found(script.proofs["b"])
    assert kinds == ([(0, 0, "ignored-trigger"), (0, 1, "ignored-trigger")] if ignored else [])
    causes = {f.row: f.cause for f in script.finished["b"] if f.verdict is Verdict.MISSING}
    assert all(("did not expose" if ignored else "lost in transfer") in causes[row] for row in (0, 1))


def test_an_ignored_trigger_and_a_spurious_one_soon_after(script: RecorderScript) -> None:
    """The frame is within the tolerance and its id fits: only the comparison of the clocks finds it."""
    film_rows(script, 0, range(3))
    script.frame(("a", 0, -1), at_s(3) + 0.004, 0.02)
    film_rows(script, 0, range(4, ROWS))
    proof = proof_of(script)
    assert not proof.proven
    assert kinds_found(proof) == [(0, 3, "off-beat")]
    assert "+4000 µs" in proof.findings[0].text
    assert "+4000 µs" in next(f.cause for f in script.finished["a"] if (f.camera, f.row) == (0, 3))


@pytest.mark.parametrize("interval_s", [0.033, PERIOD_S, 1.7 * PERIOD_S, PERIOD_S * 1.0003])
def test_a_camera_that_runs_freely(script: RecorderScript, interval_s: float) -> None:
    """Its rate may equal that of the pulses, and its frames may lie within the tolerance."""
    start_s = START_S - 4 * PERIOD_S + 0.006
    for n in range(int(1.5 / interval_s)):
        exposed_s = start_s + n * interval_s
        script.frame(("a", 0, -1), exposed_s, 0.02)
    proof = proof_of(script)
    assert kinds_found(proof) == [(0, None, "runs-freely")]
    assert f"every {interval_s * 1e3:.1f} ms" in proof.findings[0].text
    assert [c.proven for c in proof.cameras] == [False, True]


@pytest.mark.parametrize("what", ["ids", "dates", "both"])
def test_an_exchanged_pair(script: RecorderScript, what: str) -> None:
    """Frames of rows 3 and 4 carry the id, the time stamp, or both, of the other."""
    for row in range(ROWS):
        number = script.skip_id(0)
        other = {3: 4, 4: 3}.get(row, row)
        dated_s = at_s(other) if what in ("dates", "both") else None
        frame_id = number + other - row if what in ("ids", "both") else number
        script.frame(("a", 0, row), at_s(row), 0.02, dated_s=dated_s, frame_id=frame_id)
    proof = proof_of(script)
    assert not proof.proven
    if what == "both":
        assert {(0, 3, "exchanged"), (0, 4, "early")} <= set(kinds_found(proof))
    else:
        assert {(0, 3, "exchanged"), (0, 4, "exchanged")} <= set(kinds_found(proof))
        assert "which should be that of row 4" in next(f.text for f in proof.findings if f.row == 3)
    assert {f.camera for f in proof.findings} == {0}


def test_a_camera_that_was_away_restarts_its_frame_ids(script: RecorderScript) -> None:
    film_rows(script, 0, range(3))
    script.recorder.outages.begin(0, at_s(2) + 0.05, "its cable")
    script.recorder.outages.end(0, at_s(5) - 0.05)
    for row in range(5, ROWS):
        script.frame(("a", 0, row), at_s(row), 0.02, frame_id=1 + row - 5)
    proof = proof_of(script)
    assert proof.proven
    assert proof.findings == ()
    assert {f.cause for f in script.finished["a"] if f.verdict is Verdict.MISSING} == {"the camera was lost: its cable"}


def test_the_only_frame_of_a_camera_with_an_unknown_latency(script: RecorderScript) -> None:
    """Five triggers were ignored, and something else exposed 8 ms after the sixth pulse."""
    script.frame(("a", 0, -1), at_s(5) + 0.008, 0.02)
    proof = proof_of(script)
    assert set(kinds_found(proof)) >= {(0, 5, "off-beat"), (0, None, "latency-ambiguous")}
    assert not proof.cameras[0].proven
    [frame] = [f for f in script.finished["a"] if f.camera == 0 and f.verdict is Verdict.OK]
    assert "8.0 ms after its pulse" in frame.cause


faults = st.sampled_from(
    ["ok"] * 8 + ["lost", "ignored", "incomplete", "double", "spurious", "exchanged", "wrong time stamp"]
)


@settings(max_examples=300)
@given(st.data())
def test_with_any_combination_of_faults_a_frame_in_a_wrong_row_is_questioned(data: st.DataObject) -> None:
    """And what is only missing calls nothing into question."""
    script, rows = RecorderScript(1), data.draw(st.integers(6, 12))
    script.run("a", START_S, rows, data.draw(st.floats(0, 0.05)))
    fates = data.draw(st.lists(faults, min_size=rows, max_size=rows))
    fates = [f for k, f in enumerate(fates) if k == 0 or fates[k - 1] != "exchanged"]  # it befalls two rows
    if sum(f not in ("ok", "lost", "ignored", "incomplete") for f in fates) > 1:
        event("several")
    row = 0
    for fate in fates:
        row += _schedule(script, row, rows, fate, data)
        if row >= rows:
            break
    script.play()
    script.check_slots()
    proof = script.proofs["a"]
    questioned = {f.row for f in proof.findings if f.kind in QUESTIONING_KINDS}
    for frame in script.finished["a"]:
        if frame.verdict is not Verdict.OK or frame.slot is None:
            continue
        of_this_row = script.truth[frame.slot] == ("a", 0, frame.row)
        assert of_this_row or frame.row in questioned or None in questioned, fates
        assert of_this_row or frame.cause
    # The only frame after many pulses shows nothing about the latency of its camera.
    if set(fates) <= {"ok", "lost", "incomplete", "ignored"} and (fates[0] == "ok" or fates.count("ok") != 1):
        assert proof.proven
    if set(fates) <= {"ok"}:
        assert not proof.findings


def _schedule(script: RecorderScript, row: int, rows: int, fate: str, data: st.DataObject) -> int:
    """Schedule the frames of a row with a fault; return the count of rows that it concerned."""
    exposed_s, latency_s = at_s(row), data.draw(st.floats(0.01, 0.05))
    if fate == "lost":
        script.skip_id(0)
    elif fate == "incomplete":
        script.frame(("a", 0, row), exposed_s, latency_s, complete=False)
    elif fate == "spurious":  # the pulse is ignored, something else triggers
        script.frame(("a", 0, -1), exposed_s + data.draw(st.floats(0.001, 0.09)), latency_s)
    elif fate == "wrong time stamp":
        script.frame(("a", 0, row), exposed_s, latency_s, dated_s=exposed_s + data.draw(st.floats(-0.009, 0.009)))
    elif fate == "exchanged" and row + 1 < rows:
        first, second = script.skip_id(0), script.skip_id(0)
        script.frame(("a", 0, row), exposed_s, latency_s, dated_s=at_s(row + 1), frame_id=second)
        script.frame(("a", 0, row + 1), at_s(row + 1), latency_s, dated_s=exposed_s, frame_id=first)
        return 2
    elif fate != "ignored":
        script.frame(("a", 0, row), exposed_s, latency_s)
        if fate == "double":
            script.frame(("a", 0, -1), exposed_s + data.draw(st.floats(0.001, 0.09)), latency_s)
    return 1


def doubted_proof(*findings: tuple[int, int | None, Kind]) -> TriggerProof:
    found = tuple(TriggerFinding(camera=c, row=r, kind=k, text=f"text of {k}") for c, r, k in findings)
    return TriggerProof(proven=False, cameras=(), findings=found)


def test_rows_of_one_camera_and_kind_are_one_sentence() -> None:
    doubts = doubts_of(
        doubted_proof((1, 4, "off-beat"), (1, 2, "off-beat"), (0, 3, "extra-frame"), (2, None, "runs-freely"))
    )
    assert doubts == (
        "trigger of camera 1, rows 2, 4: text of off-beat; these frames are not used",
        "trigger of camera 0, row 3: text of extra-frame",
        "trigger of camera 2: text of runs-freely; these frames are not used",
    )
