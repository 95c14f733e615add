"""The recorder: whatever is late, lost, doubled or swapped, no frame ends up in a wrong row."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.acquisition.film import PERIOD_S, Film
from vaoi_station.acquisition.controller.interface import PulseFired
from vaoi_station.acquisition.pairing.recorder import Finished
from vaoi_station.model import Verdict

fates = st.sampled_from(["ok"] * 6 + ["lost", "incomplete", "late", "twice"])
latencies = st.floats(0.001, 0.09)


@given(st.data())
def test_no_frame_is_ever_in_a_wrong_row_and_every_cell_gets_a_verdict(data: st.DataObject) -> None:
    film = Film(data.draw(st.integers(1, 3)))
    expected: dict[str, dict[tuple[int, int], str]] = {}
    first_s = 1000.5
    for number in range(data.draw(st.integers(1, 3))):
        rows, name = data.draw(st.integers(1, 6)), data.draw(st.sampled_from([f"run {number}"] * 4 + [None]))
        film.run(name, first_s, rows, data.draw(st.floats(0, 0.09)))
        cells = {(c, r): data.draw(fates) for c in range(film.cameras) for r in range(rows)}
        for (camera, row), fate in cells.items():
            exposed_s = first_s + row * PERIOD_S
            latency_s = data.draw(st.floats(0.1, 0.5)) if fate == "late" else data.draw(latencies)
            if fate != "lost":
                film.frame((name, camera, row), exposed_s, latency_s, complete=fate != "incomplete")
            if fate == "twice":
                film.frame((name, camera, row), exposed_s, latency_s + 0.01)
        for camera in range(film.cameras):
            for nth in data.draw(st.lists(st.integers(0, rows), max_size=2, unique=True)):
                off_s = data.draw(st.floats(0.012, PERIOD_S - 0.012))
                film.frame((name, camera, -1), first_s + (nth - 1) * PERIOD_S + off_s, data.draw(latencies))
        if name is not None:
            expected[name] = cells
        first_s += rows * PERIOD_S + data.draw(st.floats(0.05, 1.5))
    film.play()
    film.check()
    assert set(film.finished) == set(expected)
    for name, cells in expected.items():
        verdicts = film.verdicts(name)
        assert set(verdicts) == set(cells)
        for cell, fate in cells.items():
            if fate in ("ok", "late", "twice"):
                assert verdicts[cell] is Verdict.OK
            else:
                assert verdicts[cell] in (
                    Verdict.MISSING,
                    Verdict.INCOMPLETE if fate == "incomplete" else verdicts[cell],
                )
                assert verdicts[cell] is not Verdict.OK


def test_a_clean_run_is_finished_with_its_last_frame() -> None:
    film = Film(2)
    film.run("a", 1000.0, 3, 0.001)
    for camera in range(2):
        for row in range(3):
            film.frame(("a", camera, row), 1000.0 + row * PERIOD_S, 0.02)
    film.play()
    film.check()
    assert set(film.verdicts("a").values()) == {Verdict.OK}
    (sheet,) = [o.sheet for o in film.outcomes if isinstance(o, Finished)]
    assert sheet.times_s() == pytest.approx((0.0, 0.1, 0.2), abs=1e-5)
    assert sheet.last_frame_host_s == pytest.approx(1000.22)
    assert sheet.strays == 0
    assert all(abs(f.pulse_error_us or 0) < 100 for f in film.finished["a"])


def test_a_frame_that_is_known_before_its_pulse_waits_for_it() -> None:
    film = Film(1)
    film.run("a", 1000.0, 2, 0.08)
    for row in range(2):
        film.frame(("a", 0, row), 1000.0 + row * PERIOD_S, 0.01)
    film.play()
    film.check()
    assert set(film.verdicts("a").values()) == {Verdict.OK}


def test_frames_that_arrive_in_the_wrong_order_are_sorted_by_time() -> None:
    film = Film(1)
    film.run("a", 1000.0, 3, 0.0)
    for row, latency_s in enumerate((0.45, 0.02, 0.3)):
        film.frame(("a", 0, row), 1000.0 + row * PERIOD_S, latency_s)
    film.play()
    film.check()
    assert set(film.verdicts("a").values()) == {Verdict.OK}


def test_a_frame_that_comes_while_the_next_board_is_filmed_belongs_to_its_own() -> None:
    film = Film(1)
    film.run("a", 1000.0, 2, 0.0)
    film.run("b", 1000.3, 3, 0.0)
    film.frame(("a", 0, 0), 1000.0, 0.01)
    film.frame(("a", 0, 1), 1000.1, 0.45)
    for row in range(3):
        film.frame(("b", 0, row), 1000.3 + row * PERIOD_S, 0.01)
    film.play()
    film.check()
    assert set(film.verdicts("a").values()) == set(film.verdicts("b").values()) == {Verdict.OK}


def test_a_frame_later_than_the_deadline_is_a_stray_and_its_cell_missing() -> None:
    film = Film(1)
    film.run("a", 1000.0, 2, 0.0)
    film.frame(("a", 0, 0), 1000.0, 0.01)
    film.frame(("a", 0, 1), 1000.1, 1.5)
    film.play()
    film.check()
    assert film.verdicts("a")[0, 1] is Verdict.MISSING
    assert "which is over" in film.strays[0].why


def test_an_incomplete_frame_is_named_only_where_nothing_else_is_possible() -> None:
    film = Film(2)
    film.run("a", 1000.0, 3, 0.0)
    for camera, row in ((0, 0), (0, 2), (1, 0)):
        film.frame(("a", camera, row), 1000.0 + row * PERIOD_S, 0.02)
    film.frame(("a", 0, 1), 1000.1, 0.15, complete=False)
    film.frame(("a", 1, 2), 1000.2, 0.02, complete=False)
    film.play()
    film.check()
    verdicts = film.verdicts("a")
    assert verdicts[0, 1] is Verdict.INCOMPLETE
    assert {verdicts[1, 1], verdicts[1, 2]} == {Verdict.MISSING}, "it may be of row 1 or of row 2"
    assert "several" in film.strays[0].why


def test_causality_alone_may_name_an_incomplete_frame() -> None:
    """Row 1 is lost too, but its pulse came only after the torn frame had arrived."""
    film = Film(1)
    film.run("a", 1000.0, 3, 0.0)
    film.frame(("a", 0, 0), 1000.0, 0.02, complete=False)
    film.frame(("a", 0, 2), 1000.2, 0.02)
    film.play()
    film.check()
    assert film.verdicts("a") == {(0, 0): Verdict.INCOMPLETE, (0, 1): Verdict.MISSING, (0, 2): Verdict.OK}


def test_a_free_running_camera_fills_no_row() -> None:
    film = Film(1)
    film.run("a", 1000.0, 3, 0.0)
    for n in range(12):
        film.frame(("a", 0, -1), 1000.015 + n * 0.033, 0.01)
    film.play()
    film.check()
    assert set(film.verdicts("a").values()) == {Verdict.MISSING}
    assert any("ms away" in s.why for s in film.strays)


def test_the_cause_of_a_loss_is_told_by_frame_ids() -> None:
    film = Film(1)
    film.run("a", 1000.0, 3, 0.0)
    film.frame(("a", 0, 0), 1000.0, 0.01)
    film.skip_id(0)
    film.frame(("a", 0, 2), 1000.2, 0.01)
    film.play()
    assert "lost on the way" in film.finished["a"][1].cause


def test_rows_that_a_camera_missed_while_it_was_away_have_that_cause() -> None:
    film = Film(2)
    film.run("a", 1000.0, 4, 0.0)
    for row in range(4):
        film.frame(("a", 0, row), 1000.0 + row * PERIOD_S, 0.01)
    film.frame(("a", 1, 0), 1000.0, 0.01)
    film.recorder.outages.lost(1, 1000.05, "it does not answer any more")
    film.recorder.outages.back(1, 1000.25)
    film.play()
    film.check()
    causes = {(f.camera, f.row): f.cause for f in film.finished["a"] if f.verdict is Verdict.MISSING}
    assert causes == {
        (1, 1): "the camera was lost: it does not answer any more",
        (1, 2): "the camera was lost: it does not answer any more",
        (1, 3): "no frame came after the last one seen",
    }


def test_a_lost_report_of_a_pulse_is_told_and_dated_by_its_neighbours() -> None:
    film = Film(1)
    recorder = film.recorder
    sheet = recorder.begin("a", 0, PERIOD_S)
    start_s = film.controller.device_s(1000.0)
    for row in (0, 2):
        film.outcomes += recorder.pulse(PulseFired(0, start_s + row * PERIOD_S, row, ""), 1000.0 + row * PERIOD_S)[1]
        film.frame(("a", 0, row), 1000.0 + row * PERIOD_S, 0.01)
    film.outcomes += recorder.end(sheet, 3, "clear", 1000.2)
    film.play()
    assert "report of this pulse was lost" in film.finished["a"][1].cause
    assert sheet.times_s() == (0.0, 0.1, 0.2)
    assert sheet.lights() is None


def test_frames_of_a_missed_board_are_given_back() -> None:
    film = Film(1)
    film.run(None, 1000.0, 2, 0.0)
    for row in range(2):
        film.frame((None, 0, row), 1000.0 + row * PERIOD_S, 0.01)
    film.play()
    film.check()
    assert film.finished == {}
    assert all("missed" in s.why for s in film.strays)
