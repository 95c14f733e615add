"""The proof of a run: what is wrong with a trigger is recognised and named; and whatever is wrong, no frame stands
unquestioned in a row that it is not of."""

from __future__ import annotations

import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from tests.acquisition.film import PERIOD_S, Film
from vaoi_station.acquisition.pairing.proof import QUESTIONS, TriggerFinding, TriggerProof
from vaoi_station.model import Verdict

START_S = 1000.0
ROWS = 8


def at_s(row: int) -> float:
    return START_S + row * PERIOD_S


def film_rows(film: Film, camera: int, rows: range | list[int]) -> None:
    for row in rows:
        film.frame(("a", camera, row), at_s(row), 0.02)


def proof_of(film: Film) -> TriggerProof:
    film.play()
    film.check_accounts()
    return film.proofs["a"]


def named(proof: TriggerProof) -> list[tuple[int, int | None, str]]:
    return [(f.camera, f.row, f.kind) for f in proof.findings]


@pytest.fixture
def film() -> Film:
    """Two cameras, one run; camera 1 does what it should."""
    film = Film(2)
    film.run("a", START_S, ROWS, 0.001)
    film_rows(film, 1, range(ROWS))
    return film


def test_a_run_without_faults_is_proven_with_its_figures(film: Film) -> None:
    film_rows(film, 0, range(ROWS))
    proof = proof_of(film)
    assert proof.proven
    assert proof.findings == ()
    for camera in proof.cameras:
        assert (camera.pulses, camera.frames, camera.extra) == (ROWS, ROWS, 0)
        assert camera.max_residual_us is not None
        assert camera.max_residual_us < 1
        assert camera.latency_us == pytest.approx(7, abs=100)


def test_frames_lost_on_the_way_leave_the_others_proven(film: Film) -> None:
    for row in range(ROWS):
        if row in (2, 3):
            film.skip_id(0)
        else:
            film.frame(("a", 0, row), at_s(row), 0.02)
    proof = proof_of(film)
    assert proof.proven
    assert proof.findings == ()
    assert proof.cameras[0].frames == ROWS - 2


def test_an_ignored_trigger(film: Film) -> None:
    film_rows(film, 0, [0, 1, 2, 4, 5, 6, 7])
    proof = proof_of(film)
    assert proof.proven
    assert named(proof) == [(0, 3, "ignored-trigger")]
    assert "did not expose" in next(f.cause for f in film.finished["a"] if (f.camera, f.row) == (0, 3))


@pytest.mark.parametrize("ignored", [True, False])
def test_the_first_rows_are_explained_by_the_run_before(film: Film, ignored: bool) -> None:
    """The camera went on counting from there."""
    film_rows(film, 0, range(ROWS))
    start_s = at_s(ROWS) + 2.0
    film.run("b", start_s, 4, 0.001)
    if not ignored:
        film.skip_id(0), film.skip_id(0)
    for camera, rows in ((0, (2, 3)), (1, range(4))):
        for row in rows:
            film.frame(("b", camera, row), start_s + row * PERIOD_S, 0.02)
    film.play()
    film.check_accounts()
    assert film.proofs["b"].proven
    kinds = named(film.proofs["b"])
    assert kinds == ([(0, 0, "ignored-trigger"), (0, 1, "ignored-trigger")] if ignored else [])
    causes = {f.row: f.cause for f in film.finished["b"] if f.verdict is Verdict.MISSING}
    assert all(("did not expose" if ignored else "lost on the way") in causes[row] for row in (0, 1))


def test_a_double_trigger(film: Film) -> None:
    film_rows(film, 0, range(4))
    film.frame(("a", 0, -1), at_s(3) + 0.041, 0.02)
    film_rows(film, 0, range(4, ROWS))
    proof = proof_of(film)
    assert proof.proven
    assert named(proof) == [(0, 3, "extra-frame")]
    assert "41.0 ms after the pulse of row 3" in proof.findings[0].text


def test_a_double_trigger_whose_frame_was_lost_as_well(film: Film) -> None:
    film_rows(film, 0, range(4))
    film.skip_id(0)
    film_rows(film, 0, range(4, ROWS))
    proof = proof_of(film)
    assert proof.proven
    assert named(proof) == [(0, 4, "extra-frame")]


def test_an_ignored_trigger_and_a_spurious_one_soon_after(film: Film) -> None:
    """Near enough to be taken for the row's, and counted as it should be: the clocks alone tell."""
    film_rows(film, 0, range(3))
    film.frame(("a", 0, -1), at_s(3) + 0.004, 0.02)
    film_rows(film, 0, range(4, ROWS))
    proof = proof_of(film)
    assert not proof.proven
    assert named(proof) == [(0, 3, "off-beat")]
    assert "+4000 µs" in proof.findings[0].text
    assert "+4000 µs" in next(f.cause for f in film.finished["a"] if (f.camera, f.row) == (0, 3))


@pytest.mark.parametrize("interval_s", [0.033, PERIOD_S, 1.7 * PERIOD_S, PERIOD_S * 1.0003])
def test_a_camera_that_runs_freely(film: Film, interval_s: float) -> None:
    """Even at the pulses' own rate, near enough to be taken for theirs."""
    start_s = START_S - 4 * PERIOD_S + 0.006
    for n in range(int(1.5 / interval_s)):
        exposed_s = start_s + n * interval_s
        film.frame(("a", 0, -1), exposed_s, 0.02)
    proof = proof_of(film)
    assert named(proof) == [(0, None, "runs-freely")]
    assert f"every {interval_s * 1e3:.1f} ms" in proof.findings[0].text
    assert [c.proven for c in proof.cameras] == [False, True]


@pytest.mark.parametrize("what", ["ids", "dates", "both"])
def test_an_exchanged_pair(film: Film, what: str) -> None:
    """Frames of rows 3 and 4: the one carries what the camera should have said of the other."""
    for row in range(ROWS):
        number = film.skip_id(0)
        other = {3: 4, 4: 3}.get(row, row)
        dated_s = at_s(other) if what in ("dates", "both") else None
        frame_id = number + other - row if what in ("ids", "both") else number
        film.frame(("a", 0, row), at_s(row), 0.02, dated_s=dated_s, frame_id=frame_id)
    proof = proof_of(film)
    assert not proof.proven
    if what == "both":
        assert {(0, 3, "exchanged"), (0, 4, "early")} <= set(named(proof))
    else:
        assert {(0, 3, "exchanged"), (0, 4, "exchanged")} <= set(named(proof))
        assert "which should be that of row 4" in next(f.text for f in proof.findings if f.row == 3)
    assert {f.camera for f in proof.findings} == {0}


def test_a_camera_that_was_away_counts_anew(film: Film) -> None:
    film_rows(film, 0, range(3))
    film.recorder.outages.lost(0, at_s(2) + 0.05, "its cable")
    film.recorder.outages.back(0, at_s(5) - 0.05)
    for row in range(5, ROWS):
        film.frame(("a", 0, row), at_s(row), 0.02, frame_id=1 + row - 5)
    proof = proof_of(film)
    assert proof.proven
    assert proof.findings == ()
    assert {f.cause for f in film.finished["a"] if f.verdict is Verdict.MISSING} == {"the camera was lost: its cable"}


faults = st.sampled_from(["ok"] * 8 + ["lost", "ignored", "torn", "double", "spurious", "exchanged", "dated wrongly"])


@settings(max_examples=300)
@given(st.data())
def test_whatever_is_wrong_no_frame_stands_unquestioned_in_a_row_that_it_is_not_of(data: st.DataObject) -> None:
    """And what is only missing calls nothing into question."""
    film, rows = Film(1), data.draw(st.integers(6, 12))
    film.run("a", START_S, rows, data.draw(st.floats(0, 0.05)))
    fates = data.draw(st.lists(faults, min_size=rows, max_size=rows))
    fates = [f for k, f in enumerate(fates) if k == 0 or fates[k - 1] != "exchanged"]  # it befalls two rows
    if sum(f not in ("ok", "lost", "ignored", "torn") for f in fates) > 1:
        event("several")
    row = 0
    for fate in fates:
        row += _suffer(film, row, rows, fate, data)
        if row >= rows:
            break
    film.play()
    film.check_accounts()
    proof = film.proofs["a"]
    questioned = {f.row for f in proof.findings if f.kind in QUESTIONS}
    for frame in film.finished["a"]:
        if frame.verdict is not Verdict.OK or frame.slot is None:
            continue
        of_this_row = film.truth[frame.slot] == ("a", 0, frame.row)
        assert of_this_row or frame.row in questioned or None in questioned, fates
        assert of_this_row or frame.cause
    if set(fates) <= {"ok", "lost", "torn", "ignored"}:
        assert proof.proven
    if set(fates) <= {"ok"}:
        assert not proof.findings


def _suffer(film: Film, row: int, rows: int, fate: str, data: st.DataObject) -> int:
    """What becomes of a row; returns how many rows that were."""
    exposed_s, latency_s = at_s(row), data.draw(st.floats(0.01, 0.05))
    if fate == "lost":
        film.skip_id(0)
    elif fate == "torn":
        film.frame(("a", 0, row), exposed_s, latency_s, complete=False)
    elif fate == "spurious":  # the pulse is ignored, something else triggers
        film.frame(("a", 0, -1), exposed_s + data.draw(st.floats(0.001, 0.09)), latency_s)
    elif fate == "dated wrongly":
        film.frame(("a", 0, row), exposed_s, latency_s, dated_s=exposed_s + data.draw(st.floats(-0.009, 0.009)))
    elif fate == "exchanged" and row + 1 < rows:
        first, second = film.skip_id(0), film.skip_id(0)
        film.frame(("a", 0, row), exposed_s, latency_s, dated_s=at_s(row + 1), frame_id=second)
        film.frame(("a", 0, row + 1), at_s(row + 1), latency_s, dated_s=exposed_s, frame_id=first)
        return 2
    elif fate != "ignored":
        film.frame(("a", 0, row), exposed_s, latency_s)
        if fate == "double":
            film.frame(("a", 0, -1), exposed_s + data.draw(st.floats(0.001, 0.09)), latency_s)
    return 1


def test_findings_are_plain_data(film: Film) -> None:
    film_rows(film, 0, [0, 1, 2, 4, 5, 6, 7])
    proof = proof_of(film)
    again = TriggerProof.model_validate_json(proof.model_dump_json())
    assert again == proof
    assert isinstance(again.findings[0], TriggerFinding)
