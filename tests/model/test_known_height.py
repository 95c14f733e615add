"""Heights of bodies: a sure measurement before the nominal height, in one order for all pictures."""

from __future__ import annotations

from typing import Any

import pytest

from vaoi_station.model import BoardType, Component, Status, Stitch
from vaoi_station.model.known_height import BodyHeight, body_height, known_height_mm, with_heights

U1 = Component(ref="U1", center=(5, 5), width=2, height=2)
NOMINAL = U1.model_copy(update={"body_height": 0.1})


def board(**options: Any) -> BoardType:
    data = {"name": "b", "outline": [[0, 0], [40, 30]], "fiducials": []}
    return BoardType.model_validate(data | options)


def result(quality: dict[str, Any]) -> Stitch:
    return Stitch(
        method="test", image_matrices=(), cad_matrix=None, row_motion=(), status=Status.FAILED, quality=quality
    )


def measured(height: Any, sigma: Any) -> Stitch:
    return result({"heights_mm": {"U1": height}, "height_sigma_mm": {"U1": sigma}})


@pytest.mark.parametrize(
    ("height", "sigma", "expected"),
    [(1.2, 0.05, 1.2), (0.1, 0.05, 0.0), (1.2, 0.5, 0.0), (None, 0.1, 0.0), (1.0, None, 0.0), (True, 0.1, 0.0)],
)
def test_a_measured_height_counts_if_it_is_sure(height: Any, sigma: Any, expected: float) -> None:
    assert known_height_mm(U1, board(), measured(height, sigma)) == expected


def test_the_height_of_the_board_type_counts_if_none_is_measured_surely() -> None:
    inches = board(unit="inch")
    for unsure in (result({}), measured(1.2, 0.5), measured(None, 0.1), measured(float("nan"), 0.1)):
        assert body_height(NOMINAL, inches, unsure) == BodyHeight(2.54, None, "board-type")
        assert known_height_mm(NOMINAL, inches, unsure) == 2.54
    assert body_height(U1, inches, result({})) is None
    assert body_height(U1, inches, measured(1.5, 0.3)) == BodyHeight(1.5, 0.3, "measured"), "better than the board"


def test_a_sure_measurement_comes_before_the_board_type() -> None:
    """The board may have another part than its CAD data state, or none."""
    assert body_height(NOMINAL, board(unit="inch"), measured(1.2, 0.05)) == BodyHeight(1.2, 0.05, "measured")
    assert known_height_mm(NOMINAL, board(unit="inch"), measured(1.2, 0.05)) == 1.2
    assert known_height_mm(NOMINAL, board(unit="inch"), measured(0.01, 0.02)) == 0, "the part is missing"


@pytest.mark.parametrize("figures", [{}, {"U1": None}, [1], "U1"])
def test_figures_of_any_form_are_accepted(figures: Any) -> None:
    assert body_height(U1, board(), result({"heights_mm": figures, "height_sigma_mm": figures})) is None


def test_heights_of_all_frames_replace_those_of_the_links() -> None:
    links = result({"heights_mm": {"U1": 1.0, "U2": 2.0}, "height_sigma_mm": {"U1": 0.2, "U2": 0.3}})
    found = with_heights(links, {"U1": (1.25, 0.01)})
    assert found.quality["heights_mm"] == {"U1": 1.25, "U2": 2.0}
    assert found.quality["height_sigma_mm"] == {"U1": 0.01, "U2": 0.3}
    assert with_heights(links, {}) is links
