"""The hostile suite in short: some drawings, and the kept finds; `python -m tests.hostile` runs thousands."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from tests.hostile import judging
from tests.hostile.drawing import FIRST_WITH_SURROUNDINGS, Drawing, draw
from tests.hostile.filming import film
from tests.hostile.judging import judge
from tests.hostile.mistakes import KINDS, NEAR_COPY, Mistake, draw_mistakes
from tests.hostile.rule import fiducials_in_view, least_seen, why_impossible
from tests.hostile.summary import kept_finds, open_classes, table
from tests.needs import LONG

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


def test_every_kind_of_mistake_is_drawn_on_both_sides_of_its_limit() -> None:
    g = np.random.default_rng(1)
    drawn = [m for _ in range(20_000) for m in draw_mistakes(g, cameras=2)]
    names = Counter(m.name for m in drawn)
    assert set(names) == set(KINDS)
    for name, kind in KINDS.items():
        within = {m.within for m in drawn if m.name == name}
        assert within == ({False} if kind.limit < kind.low else {True} if kind.limit >= kind.high else {False, True})


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


def test_kept_finds_have_a_diagnosis() -> None:
    for find in kept_finds():
        assert set(find) == {"seed", "classes", "mended", "diagnosis"}
        assert find["classes"]
        assert find["diagnosis"]
