"""A result as rows: values as the result states them, None for what it does not state."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station import StitchedRun
from vaoi_station.geometry import apply
from vaoi_station.plant.tables import RunKey, result_tables

KEY = RunKey("line 1", "r1", "2026-11-23T10:00:00Z", "small", "B1")


def test_every_figure_is_that_of_the_result(stitched: StitchedRun) -> None:
    result, head = stitched.result, stitched.recording.head
    tables = result_tables(KEY, "new", result, stitched.board_type, head)
    assert {len(values) for values in tables["runs"].values()} == {1}
    assert tables["runs"]["status"] == ["ok"]
    assert tables["runs"]["board_id"] == ["B1"]
    assert tables["runs"]["link_median_px"] == [result.quality["residual_px"]["median"]]
    assert tables["rows"]["row"] == list(range(head.rows))
    assert tables["rows"]["sigma_px"] == result.quality["row_sigma_px"]
    assert tables["rows"]["y_mm"][1] == pytest.approx(11.0, rel=0.05), "100 mm/s for 0.11 s"
    assert tables["seams"]["residual_px"] == list(result.quality["seams_px"].values())
    assert [[x, y] for x, y in zip(tables["cameras"]["x_px"], tables["cameras"]["y_px"], strict=True)] == [
        moved[:2] for moved in result.quality["camera_displacement_px"]
    ]
    assert tables["cameras"]["px_per_mm"] == pytest.approx([18.0] * 3, rel=0.02)
    assert tables["fiducials"]["name"] == [mark["name"] for mark in result.quality["fiducials"]]


def test_components_have_place_height_and_views(stitched: StitchedRun) -> None:
    result = stitched.result
    tables = result_tables(KEY, "new", result, stitched.board_type, stitched.recording.head)
    components, views = tables["components"], tables["views"]
    assert components["component"] == list(stitched.refs)
    n = components["component"].index("U1")
    matrix = result.component_matrix("U1")
    assert matrix is not None
    place = apply(matrix, np.array([stitched.center("U1")]))[0]
    assert (components["x_mm"][n], components["y_mm"][n]) == pytest.approx(place.tolist())
    assert components["height_mm"][n] == result.quality["heights_mm"]["U1"]
    assert result.components is not None
    assert components["views"][n] == len(result.components["U1"]) == views["component"].count("U1")
    stated = [float(np.linalg.eigvalsh([[xx, xy], [xy, yy]])[1] ** 0.5) for _, _, xx, xy, yy in
              result.quality["component_covariance_px2"]["U1"]]  # fmt: skip
    found = [s for name, s in zip(views["component"], views["sigma_px"], strict=True) if name == "U1"]
    assert found == pytest.approx(stated)


def test_figures_of_another_form_are_none(stitched: StitchedRun) -> None:
    """The quality of a result accepts any keys and values, also those of older versions."""
    wrong = {
        "residual_px": [1],
        "belt": None,
        "row_sigma_px": "much",
        "camera_displacement_px": [[0, 0]],
        "seams_px": {"a-b": 1},
        "fiducials": [7],
        "component_sigma_px": {"U1": True},
        "component_covariance_px2": {"U1": 3},
        "cad_sigma_px": float("nan"),
    }
    result = stitched.result.model_copy(update={"quality": wrong, "camera_matrices": None})
    tables = result_tables(KEY, "former", result, stitched.board_type, stitched.recording.head)
    assert tables["runs"]["cad_sigma_px"] == tables["runs"]["link_median_px"] == tables["runs"]["speed_mm_s"] == [None]
    assert tables["cameras"]["center_x_mm"] == tables["cameras"]["x_px"] == [None] * 3
    assert set(tables["components"]["sigma_px"]) == set(tables["views"]["sigma_px"]) == {None}
    assert tables["seams"]["camera"] == []


def test_without_a_board_type_there_are_no_components(stitched: StitchedRun) -> None:
    result = stitched.result.model_copy(update={"components": None, "cad_matrix": None})
    tables = result_tables(KEY, "new", result, None, stitched.recording.head)
    assert tables["components"]["run"] == tables["views"]["run"] == []
