"""The hostile suite in short: some drawings, and the kept finds; `python -m tests.hostile` runs thousands."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from tests.hostile import judging
from tests.hostile.drawing import FIRST_WITH_NEAR_COPIES, FIRST_WITH_SURROUNDINGS, Drawing, changed, draw
from tests.hostile.filming import film
from tests.hostile.judging import OK_AND_WRONG, Outcome, judge
from tests.hostile.mistakes import BESIDE, KINDS, MOMENTS, NEAR_COPY, Mistake, draw_beside, draw_mistakes, draw_moment
from tests.hostile.rule import blank_overlap, fiducials_in_view, least_overlap, least_seen, why_impossible
from tests.hostile.summary import interval, kept_finds, open_classes, table, table_of_mistakes
from tests.needs import LONG
from vaoi_station.geometry.transforms import apply

SEEDS = (
    *range(200 if LONG else 12),
    *range(FIRST_WITH_SURROUNDINGS, FIRST_WITH_SURROUNDINGS + (100 if LONG else 8)),
)
BLURRED_SEED = 20_105
"""A drawing with a blur of 4.5 px whose cameras are calibrated with marks."""
SHORT = (
    19,
    22,
    54,
    104,
    71026,
    71354,
    71483,
    71583,
    72039,
    80372,
    81618,
    81851,
    82166,
    82364,
    82614,
    82844,
    84655,
    84667,
    84712,
    85017,
    91283,
    91603,
    93217,
    96577,
    100346,
    101170,
    101221,
    101800,
    102577,
    103588,
    105410,
    107464,
    108935,
    111947,
)
"""Mended finds that the short form repeats: one of each class of causes."""
MOST_REFUSED = 0.05
"""Largest accepted share of refused drawings among those with an expected right answer, in the long form."""


@pytest.fixture(scope="module")
def plain() -> Drawing:
    """Provide a drawing without mistakes of which a right answer is expected."""
    drawings = (draw(seed) for seed in range(100))
    return next(d for d in drawings if not d.mistakes and not why_impossible(film(d)))


def with_mistake(drawing: Drawing, name: str, size: float) -> Drawing:
    return replace(drawing, mistakes=(Mistake(name, size, at=0, angle_rad=0.3),))


def test_no_drawing_is_ok_and_wrong_or_raises() -> None:
    outcomes = [judge(seed) for seed in SEEDS]
    new = {o.seed: set(o.finds) - open_classes(o.seed) - {"refused"} for o in outcomes}
    assert not {seed: found for seed, found in new.items() if found}, table(outcomes)
    expected = [o for o in outcomes if o.expected]
    assert len(expected) >= len(outcomes) / 5
    refused = [o for o in expected if "refused" in o.finds and "refused" not in open_classes(o.seed)]
    assert len(refused) <= MOST_REFUSED * len(expected), [(o.seed, o.reasons) for o in refused]


def test_mended_finds_stay_mended() -> None:
    mended = [find for find in kept_finds() if find["mended"]]
    assert {find["seed"] for find in mended} >= set(SHORT)
    outcomes = [judge(find["seed"]) for find in mended if LONG or find["seed"] in SHORT]
    assert not [(o.seed, o.finds, o.reasons) for o in outcomes if o.finds]


def test_marks_that_are_too_blurred_for_a_calibration_are_refused() -> None:
    outcome = judge(BLURRED_SEED)
    assert (outcome.status, outcome.finds, outcome.expected) == ("refused", (), False)
    assert "blurred" in outcome.reasons[0]


def test_equal_seeds_give_equal_drawings() -> None:
    assert draw(5) == draw(5)
    assert draw(5) != draw(6)


def test_every_kind_of_mistake_is_drawn_on_both_sides_of_its_limit() -> None:
    g = np.random.default_rng(1)
    drawn = [m for _ in range(20_000) for m in draw_mistakes(g, cameras=2)]
    names = Counter(m.name for m in drawn)
    assert set(names) == set(KINDS)
    for name, kind in KINDS.items():
        within = {m.within for m in drawn if m.name == name}
        assert within == ({False} if kind.limit < kind.low else {True} if kind.limit >= kind.high else {False, True})


def test_what_lies_beside_the_board_is_drawn_from_a_later_seed_on() -> None:
    g = np.random.default_rng(1)
    drawn = Counter(m.name for _ in range(2_000) for m in draw_beside(g))
    assert set(drawn) == set(BESIDE)
    assert not {m.name for seed in range(50) for m in draw(seed).mistakes} & set(BESIDE)
    later = [draw(seed) for seed in range(FIRST_WITH_SURROUNDINGS, FIRST_WITH_SURROUNDINGS + 20)]
    assert {m.name for d in later for m in d.mistakes} & set(BESIDE)
    assert any(d.scenario.carrier.rim_mm for d in later)
    assert any(d.scenario.texture.sigma_grey for d in later)


def test_a_frame_of_another_moment_is_drawn_from_a_later_seed_on() -> None:
    g = np.random.default_rng(1)
    assert {m.name for _ in range(100) for m in draw_moment(g, cameras=2)} == set(MOMENTS)
    later = range(FIRST_WITH_NEAR_COPIES, FIRST_WITH_NEAR_COPIES + 20)
    assert any(draw(seed).mistake(NEAR_COPY) for seed in later)
    assert not any(draw(seed - 20).mistake(NEAR_COPY) for seed in later)


@pytest.mark.parametrize("seed", [90012, 90027, 90028])
def test_a_near_copy_of_the_frame_before_is_never_right(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts at equal distances let some links and points of the reference fit in a picture of the row before."""
    drawing = draw(seed)
    again = Mistake(NEAR_COPY, 2.0, seed % drawing.scenario.array.cameras, 0.7 + seed / 1e3)
    spoilt = replace(drawing, mistakes=(again, Mistake("reference", 1.0)))
    monkeypatch.setattr(judging, "draw", lambda _: spoilt)
    outcome = judge(seed)
    assert (outcome.status, outcome.finds) == ("degraded", ())
    assert any("fit neither the frames before and after them" in reason for reason in outcome.reasons)
    film_of = film(spoilt)
    (wrong,) = (key for key, source in film_of.filmed.items() if key != source)
    result, _ = judging.stitched(film_of)
    assert result.image_matrices[wrong[0]][wrong[1]] is None, "no picture is cut out of it"
    assert result.components is not None
    assert all(wrong != (camera, row) for views in result.components.values() for camera, row, *_ in views)


def test_a_board_with_other_parts_than_the_reference_is_never_right(
    plain: Drawing, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fiducials, outline and holes of both boards are the same, and the few points of the reference there fit."""
    other = replace(plain, mistakes=(Mistake("other-type", 1.0), Mistake("reference", 1.0)))
    monkeypatch.setattr(judging, "draw", lambda _: other)
    outcome = judge(plain.seed)
    assert (outcome.status, outcome.finds) == ("degraded", ())
    assert any("components look as in the reference" in reason for reason in outcome.reasons)


def test_a_mistake_beyond_its_limit_is_the_reason_that_nothing_is_expected(plain: Drawing) -> None:
    assert why_impossible(film(with_mistake(plain, "pushed", 0.1))) == ()
    assert why_impossible(film(with_mistake(plain, "pushed", 0.5))) == ("pushed 0.5 is beyond its limit",)


def test_the_rule_demands_fiducials_and_every_footprint_in_view(plain: Drawing) -> None:
    seen = film(plain)
    assert len(fiducials_in_view(seen)) >= 2
    assert least_seen(seen) == least_seen(seen, borders=False) == 1.0
    blind = replace(seen, filmed={key: source for key, source in seen.filmed.items() if key[1] == 0})
    assert least_seen(blind) < 1.0
    assert any("in view" in reason for reason in why_impossible(blind))


def test_rows_that_are_missing_reduce_the_overlap(plain: Drawing) -> None:
    seen = film(plain)
    sparse = replace(seen, filmed={key: source for key, source in seen.filmed.items() if key[1] % 2 == 0})
    assert least_overlap(sparse) < least_overlap(seen)


def test_point_symmetric_fiducials_have_no_expected_answer(plain: Drawing) -> None:
    w, h = plain.scenario.board.width_mm, plain.scenario.board.length_mm
    marks = [{"x_mm": 3.0, "y_mm": 3.0}, {"x_mm": w - 3, "y_mm": h - 3}]
    symmetric = replace(plain, scenario=changed(plain.scenario, {"board": {"fiducials": marks}}))
    assert any("turned by 180°" in reason for reason in why_impossible(film(symmetric)))


def test_two_fiducials_under_different_cameras_need_a_component_that_both_cameras_show() -> None:
    """Without it, a lift of the board looks like a turn; a third fiducial, or two under one camera, show the lift."""
    blank, joined = film(draw(91589)), film(draw(93030))
    assert (blank_overlap(blank), blank_overlap(joined)) == ((0, 1), None)
    assert [why for why in why_impossible(blank) if "share no component" in why]
    board = blank.twin.scenario.board
    third = [*board.marks, board.marks[0].model_copy(update={"y_mm": board.length_mm - 3})]
    more = changed(blank.drawing.scenario, {"board": {"fiducials": [m.model_dump() for m in third]}})
    assert blank_overlap(film(replace(blank.drawing, scenario=more))) is None


def test_frames_of_another_row_keep_their_own_truth(plain: Drawing) -> None:
    late = film(with_mistake(plain, "late-camera", 1.0))
    assert (0, 0) not in late.frames
    assert late.filmed[0, 2] == (0, 1)
    assert np.array_equal(late.frames[0, 2], late.passage.frame(0, 1))
    place = np.array([[5.0, 5.0]])
    pose = late.passage.pose(late.passage.pulse_times_s[1])
    expected = late.passage.pinholes[0].project(apply(pose, place), late.twin.scene.surface_z(place))
    assert late.true_px((0, 2), place) == pytest.approx(expected)


def test_a_pushed_calibration_differs_by_its_size(plain: Drawing) -> None:
    pushed = film(with_mistake(plain, "pushed", 0.5))
    camera, other = (f.calibration.cameras(f.head.cameras)[0] for f in (pushed, film(plain)))
    center = np.array([[0.0, 0.0]])
    a, b = (apply(c.image_from_row.matrix, center) for c in (camera, other))
    assert np.hypot(*(a - b)[0]) == pytest.approx(0.5)


def test_spots_change_frames_of_one_camera_only(plain: Drawing) -> None:
    clean, spoilt = film(plain), film(with_mistake(plain, "glare", 60.0))
    changed_keys = {key for key in clean.frames if not np.array_equal(clean.frames[key], spoilt.frames[key])}
    assert changed_keys == {key for key in clean.frames if key[0] == 0}


def test_the_tables_name_the_seeds_of_finds() -> None:
    wrong = Outcome(7, status="ok", mistakes=("glare 60",), finds=(OK_AND_WRONG[2],))
    refused = Outcome(8, expected=True, status="failed", finds=("refused",))
    lines = table([wrong, refused]).splitlines()
    end = "| 1 | 1 | 100.0% (2.5 … 100.0) |"
    assert any(line.startswith("| wrong:") and line.endswith(f"{end} 7 |") for line in lines)
    assert any(line.startswith("| refused:") and line.endswith(f"{end} 8 |") for line in lines)
    assert "| glare | 1 | 1 | 0 | 0 | 7 |  |" in table_of_mistakes([wrong, refused])


def test_kept_finds_have_a_diagnosis() -> None:
    for find in kept_finds():
        assert set(find) == {"seed", "classes", "mended", "diagnosis"}
        assert find["classes"]
        assert find["diagnosis"]


def test_rates_have_their_exact_intervals() -> None:
    """Of the first n drawings without a find, 1 − 0.025^(1/n) is the largest rate; the others are tabulated."""
    assert interval(0, 73) == pytest.approx((0, 1 - 0.025 ** (1 / 73)))
    assert interval(73, 73) == pytest.approx((0.025 ** (1 / 73), 1))
    assert interval(1, 10) == pytest.approx((0.0025, 0.4450), abs=5e-5)
    assert interval(5, 1101) == pytest.approx((0.00148, 0.01057), abs=1e-5)
    assert interval(0, 0) == (0.0, 1.0)
