from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from vaoi_station.geometry import System
from vaoi_station.model import Status, Stitch, Surface

M = np.diag([40.0, 40, 1])
coefficients = st.floats(-2, 2)


def stitch(**change: Any) -> Stitch:
    base: dict[str, Any] = {
        "method": "m",
        "image_matrices": ((M, None),),
        "cad_matrix": np.diag([25.4, -25.4, 1]),
        "row_motion": (np.eye(3), np.eye(3)),
        "status": Status.OK,
    }
    return Stitch.model_validate(base | change)


def test_matrices_come_as_transforms_between_their_systems() -> None:
    image_from_tester, tester_from_cad = stitch().image_from_tester(0, 0), stitch().tester_from_cad
    assert image_from_tester is not None
    assert tester_from_cad is not None
    image_from_cad = image_from_tester @ tester_from_cad
    assert (image_from_cad.target, image_from_cad.source) == (System.IMAGE, System.CAD)
    np.testing.assert_allclose(image_from_cad((1, 1)), (1016, -1016))


def test_a_frame_or_board_without_a_position_gives_none() -> None:
    assert stitch().image_from_tester(0, 1) is None
    assert stitch(cad_matrix=None).tester_from_cad is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"image_matrices": ((M, M), (M,))}, r"image_matrices has cameras of \[1, 2\] rows"),
        ({"row_motion": (np.eye(3),)}, "row_motion has 1 entries, must have one per row: 2"),
        ({"status": "fine"}, "status"),
    ],
)
def test_inconsistent_results_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        stitch(**change)


def test_a_result_survives_json() -> None:
    before = stitch(surface={"lift_mm": 0.1}, components={"U1": [(0, 0, 1.5, 2.5)]})
    after = Stitch.model_validate_json(before.model_dump_json())
    assert after.model_dump_json() == before.model_dump_json()
    assert after.surface == before.surface


def test_a_number_that_json_lacks_stays_visible() -> None:
    assert "NaN" in stitch(quality={"rms_px": float("nan")}).model_dump_json()


@given(lift=coefficients, tilt=st.tuples(coefficients, coefficients), at=st.tuples(st.floats(-1, 1), st.floats(-1, 1)))
def test_a_tilted_surface_is_a_plane_through_its_origin(
    lift: float, tilt: tuple[float, float], at: tuple[float, float]
) -> None:
    surface = Surface(lift_mm=lift, tilt_mm=tilt, about=(30.0, 20.0), half_span=(40.0, 25.0))
    assert surface.height_mm(np.array([30.0, 20.0])) == pytest.approx(lift)
    cad = np.array([30 + 40 * at[0], 20 + 25 * at[1]])
    assert surface.height_mm(cad) == pytest.approx(lift + tilt[0] * at[0] + tilt[1] * at[1])


def test_a_bow_is_quadratic_and_held_constant_outside_the_board() -> None:
    surface = Surface(lift_mm=0.0, bow_mm=(1.0, 0.5, 0.25))
    cad = np.array([[0.5, 0.0], [0.0, 0.5], [0.5, 0.5], [1.2, 0.0], [50.0, 0.0]])
    np.testing.assert_allclose(surface.height_mm(cad), [0.25, 0.0625, 0.25 + 0.125 + 0.0625, 1.44, 1.44])


def test_components_follow_their_board_and_their_local_fiducials() -> None:
    shifted = [np.array([[1.0, 0.0, x], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) for x in (0.0, 0.1, 0.2)]
    panel = stitch(cad_matrix=shifted[0], board_matrices={"A": shifted[1]}, local_matrices={"A/U2": shifted[2]})
    assert panel.component_matrix("A/U1") == pytest.approx(shifted[1])
    assert panel.component_matrix("A/U2") == pytest.approx(shifted[2])
    assert panel.component_matrix("B/U1") is panel.component_matrix("A") is panel.cad_matrix
    moves = panel.displacements(["A/U1", "A/U2", "B/U1", "U3"])
    assert {ref: move[0, 2] for ref, move in moves.items()} == {"A/U1": 0.1, "A/U2": 0.2}
    assert stitch().displacements(["U1"]) == {}
