"""Heights of bodies with known height: error and standard deviation, light, missing frames, refusals."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.heights.conftest import ROW_MM, Scene
from vaoi_station.errors import StateError
from vaoi_station.heights.estimates import (
    Interval,
    PartHeight,
    compare,
    heights_document,
    measure_heights,
)
from vaoi_station.model import BoardType
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.stitching.work import StitchSetup, stitch_frames


def test_every_body_is_measured_within_its_standard_deviation(filmed: Any) -> None:
    found = measure_heights(filmed.board_type, filmed.stitch, filmed.cameras, filmed.frame)
    for component in filmed.board_type.components:
        height = found[component.ref]
        assert height.height_mm is not None
        assert height.sigma_mm is not None
        assert abs(height.height_mm - component.body_height) < 3 * height.sigma_mm, component.ref
        assert 0.005 < height.sigma_mm < 0.1
        assert height.views >= 2
        assert height.intervals == ()


ALIAS_MM = 10.84
"""With a baseline of 6 mm, 60 mm away, parts of ROW_MM at this height fall onto the pictures of their neighbours."""


def measure(filmed: Any) -> dict[str, PartHeight]:
    return measure_heights(filmed.board_type, filmed.stitch, filmed.cameras, filmed.frame)


def contains(height: PartHeight, mm: float) -> bool:
    if height.height_mm is not None and height.sigma_mm is not None:
        return abs(height.height_mm - mm) < 3.5 * height.sigma_mm
    return any(i.low_mm <= mm <= i.high_mm for i in height.intervals)


def test_a_row_of_equal_parts_in_two_views_has_two_heights_and_no_statement(film: Any) -> None:
    height = measure(film(ROW_MM, rows=2, step_mm=6.0, scene=Scene(alike=True, distance_mm=60.0)))["U3"]
    assert height.height_mm is None
    assert contains(height, 1.0)
    assert contains(height, ALIAS_MM)
    assert len(height.intervals) >= 2
    assert sum(i.probability for i in height.intervals) == pytest.approx(1, abs=0.003)
    for expected_mm in (1.0, ALIAS_MM, 5.0):
        assert compare(height, expected_mm)[0] == "ambiguous"


@pytest.mark.parametrize(("rows", "alike"), [(3, True), (2, False)])
def test_a_third_view_or_another_look_of_the_neighbours_decides(film: Any, rows: int, alike: bool) -> None:
    filmed = film(ROW_MM, rows=rows, step_mm=6.0 / (rows - 1), scene=Scene(alike=alike, distance_mm=60.0))
    height = measure(filmed)["U3"]
    assert height.height_mm == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize("contrast", [0.0, 6.0])
@pytest.mark.parametrize("rows", [2, 3])
def test_a_row_of_blank_parts_has_its_height_among_those_that_explain_the_pictures(
    film: Any, rows: int, contrast: float
) -> None:
    """A blank place fits at every height, and by chance best at a wrong one: that is no evidence."""
    for seed in range(4):
        filmed = film(ROW_MM, rows=rows, step_mm=3.0, contrast=contrast, scene=Scene(False, 60.0, 100.0, seed))
        for ref, height in measure(filmed).items():
            assert not height.intervals or contains(height, 1.0), (seed, ref)
            assert compare(height, 1.0)[0] not in ("higher", "lower"), (seed, ref)


def test_only_rows_of_one_light_are_compared(film: Any) -> None:
    """Under another light the body looks different: those pictures have nothing in common."""
    filmed = film({"U1": ((0.0, 0.0, 3.0, 2.5), 1.0, 1.5)}, rows=6, step_mm=1.5, top=lambda row, ref: row % 2)
    lights = ["left", "right"] * 3
    height = measure_heights(filmed.board_type, filmed.stitch, filmed.cameras, filmed.frame, lights)["U1"]
    assert height.height_mm == pytest.approx(1.5, abs=0.06)


def test_a_body_of_which_all_tiles_are_edges_has_no_sure_height() -> None:
    """A SOT-23 at 18 px/mm: two rows of tiles see a mixture of body, leads and board, half as high as the body."""
    twin = Twin(read_scenario(scenario_path("small")))
    passage = twin.passage(2)
    head, frames = passage.head(), passage.render_all()
    cameras = twin.calibration.cameras(head.cameras)
    setup = StitchSetup(cameras, head.conveyor_mm_s, head.trigger_period_s, twin.board_type)
    result = stitch_frames(setup, head, lambda i, j: frames.get((i, j)))
    small = {part.ref: part for part in twin.parts if part.package.name == "SOT-23"}
    chosen = tuple(c for c in twin.board_type.components if c.ref in small)
    board_type = twin.board_type.model_copy(update={"components": chosen})
    found = measure_heights(board_type, result, cameras, lambda i, j: frames.get((i, j)))
    for ref, part in small.items():
        height = found[ref]
        if height.height_mm is not None and height.sigma_mm is not None:
            assert abs(height.height_mm - part.body_height_mm) < 3 * height.sigma_mm, ref
            assert height.sigma_mm > 0.2


def test_rows_that_may_be_displaced_by_a_period_measure_nothing(filmed: Any) -> None:
    rows = range(len(filmed.stitch.row_motion))
    for apart, measured in (([list(rows)], False), ([[rows[-1]]], True)):
        stitch = filmed.stitch.model_copy(update={"quality": filmed.stitch.quality | {"rows_apart": apart}})
        heights = measure_heights(filmed.board_type, stitch, filmed.cameras, filmed.frame)
        assert any(height.height_mm is not None for height in heights.values()) is measured
    whole = measure_heights(filmed.board_type, filmed.stitch, filmed.cameras, filmed.frame)
    assert all(heights[name].views <= whole[name].views for name in whole)
    assert sum(h.views for h in heights.values()) < sum(h.views for h in whole.values())


def test_a_run_without_cad_mapping_and_a_calibration_without_working_distance_are_refused(filmed: Any) -> None:
    lost = filmed.stitch.model_copy(update={"cad_matrix": None, "reasons": ("no fiducial was found",)})
    with pytest.raises(StateError, match=r"no CAD mapping.*no fiducial was found"):
        measure_heights(filmed.board_type, lost, filmed.cameras, filmed.frame)
    flat = [replace(camera, working_distance_mm=None) for camera in filmed.cameras]
    with pytest.raises(StateError, match=r"no working_distance_mm.*state it in the calibration"):
        measure_heights(filmed.board_type, filmed.stitch, flat, filmed.frame)


def test_saturated_bodies_are_not_given_with_a_false_certainty(film: Any) -> None:
    filmed = film({"U1": ((0.0, 0.0, 3.0, 2.5), 1.0, 1.5)}, gain=lambda row: 4.0)
    height = measure_heights(filmed.board_type, filmed.stitch, filmed.cameras, filmed.frame)["U1"]
    if height.height_mm is not None and height.sigma_mm is not None:
        assert abs(height.height_mm - 1.5) < 3 * height.sigma_mm
    assert all((np.asarray(frame) >= 252).mean() > 0.5 for frame in filmed.frames.values())


def measured(mm: float, sigma: float) -> PartHeight:
    return PartHeight(mm, sigma, (), 3)


def among(*intervals: tuple[float, float, float]) -> PartHeight:
    return PartHeight(None, None, tuple(Interval(*i) for i in intervals), 2)


@pytest.mark.parametrize(
    ("height", "statement"),
    [
        (measured(1.02, 0.02), "agrees"),
        (measured(0.01, 0.05), "lower"),
        (measured(1.6, 0.05), "higher"),
        (measured(0.9, 0.1), "unknown"),
        (measured(1.25, 0.05), "unknown"),
        (among((2.0, 5.0, 0.998)), "higher"),
        (among((0.0, 5.0, 0.998)), "unknown"),
        (among((1.12, 5.0, 0.998)), "unknown"),  # the end of a wide interval is not sharp
        (among((1.12, 1.3, 0.998)), "higher"),
        (among((0.0, 0.3, 0.998)), "lower"),
        (among((0.95, 1.05, 0.6), (8.0, 9.0, 0.398)), "ambiguous"),
        (among((0.95, 1.05, 0.01), (8.0, 9.0, 0.988)), "ambiguous"),
        (among((0.95, 1.05, 0.97), (8.0, 9.0, 0.028)), "agrees"),
        (among((2.0, 3.0, 0.5), (8.0, 9.0, 0.498)), "higher"),
        (PartHeight(None, None, (), 0), "unknown"),
    ],
)
def test_statements_about_a_body_of_one_millimetre(height: PartHeight, statement: str) -> None:
    assert compare(height, 1.0)[0] == statement


@given(st.floats(-1, 12), st.floats(0.005, 2), st.floats(0.1, 10))
def test_a_statement_has_at_least_its_probability(mm: float, sigma: float, expected: float) -> None:
    statement, probability = compare(measured(mm, sigma), expected)
    assert 0 <= probability <= 1
    assert (statement == "unknown") or probability >= (0.95 if statement == "agrees" else 0.995)
    assert statement != "unknown" or probability < 0.995


def test_the_document_has_heights_in_mm_and_expectations_of_the_board_type() -> None:
    board = BoardType(
        name="b",
        unit="inch",
        outline=((0, 0), (2, 2)),
        components=[
            {"ref": "U1", "center": (1, 1), "width": 0.1, "height": 0.1, "body_height": 0.04},
            {"ref": "R1", "center": (1, 0.5), "width": 0.1, "height": 0.1, "panel": "A"},
            {"ref": "R2", "center": (1, 0.7), "width": 0.1, "height": 0.1},
        ],
    )
    found = {
        "U1": measured(1.01234, 0.02),
        "A/R1": among((0.5, 2.0, 0.998)),
        "R2": among((0.5, 1.0, 0.6), (7.0, 8.0, 0.39812)),
    }
    assert heights_document(found, board) == {
        "U1": {
            "height_mm": 1.0123,
            "sigma_mm": 0.02,
            "views": 3,
            "expected_mm": 1.016,
            "comparison": "agrees",
            "probability": 0.9907,
        },
        "A/R1": {"height_mm": None, "sigma_mm": None, "views": 2, "low_mm": 0.5, "high_mm": 2.0},
        "R2": {
            "height_mm": None,
            "sigma_mm": None,
            "views": 2,
            "low_mm": 0.5,
            "high_mm": 8.0,
            "intervals": [
                {"low_mm": 0.5, "high_mm": 1.0, "probability": 0.6},
                {"low_mm": 7.0, "high_mm": 8.0, "probability": 0.3981},
            ],
        },
    }
