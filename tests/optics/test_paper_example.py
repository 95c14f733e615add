from __future__ import annotations

import pytest

from vaoi_station.optics import make_plan
from vaoi_station.optics.paper_example import PAPER, compare_with_paper

FIGURES = {f.name: f for f in compare_with_paper(make_plan(PAPER))}


@pytest.mark.parametrize(
    ("name", "tolerance"),
    [
        ("focal length at d_max", 0.05),
        ("distance for the 75 mm lens", 0.5),
        ("longest exposure", 1e-9),
        ("data rate", 0.05),
        ("capture duration", 1e-9),
    ],
)
def test_printed_figures_agree_with_the_equations(name: str, tolerance: float) -> None:
    figure = FIGURES[name]
    assert figure.computed == pytest.approx(figure.paper, abs=tolerance)


@pytest.mark.parametrize(("name", "computed"), [("cameras needed", 12.069), ("lowest frame rate", 8.0769)])
def test_two_printed_figures_are_rounded_down(name: str, computed: float) -> None:
    figure = FIGURES[name]
    assert figure.computed == pytest.approx(computed, abs=1e-3)
    assert figure.paper is not None
    assert figure.computed is not None
    assert figure.paper < figure.computed
    assert "rounds in its own favour" in figure.remark


def test_the_f_number_is_missing_in_the_paper() -> None:
    figure = FIGURES["f-number"]
    assert (figure.paper, figure.computed) == (None, None)
    assert "circle of confusion" in figure.remark
