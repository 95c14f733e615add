"""The sections of the report."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.files import read_calibration, write_calibration
from vaoi_station.model import BoardType
from vaoi_station.reporting import StitchedRun, restitch
from vaoi_station.reporting.figures import (
    data_block,
    deviation,
    digest,
    fiducials,
    frame_table,
    identity,
    key_numbers,
    seams,
)
from vaoi_station.reporting.maps import (
    BoardDrawing,
    components,
    layout,
    residual_vectors,
    surface,
    tile_graph,
    vectors,
)
from vaoi_station.stitching.recordings.opening import open_run


@pytest.mark.parametrize("y_axis", ["up", "down"])
def test_cad_up_is_drawn_upwards(y_axis: str) -> None:
    plan = BoardDrawing(BoardType.model_validate({"name": "b", "outline": [[0, 0], [40, 20]], "y_axis": y_axis}))
    at = plan.at(np.array([[0.0, 0.0], [40.0, 20.0]]))
    assert at[0, 0] < at[1, 0]
    assert (at[0, 1] > at[1, 1]) == (y_axis == "up")
    assert (at >= 0).all()
    assert (at <= (plan.width, plan.height)).all()


def test_components_and_surface_are_drawn(stitched: StitchedRun) -> None:
    board_type, q = stitched.opened.setup.board_type, stitched.result.quality
    assert board_type is not None
    html = components(stitched).html()
    unknown = len(board_type.components) - len(q["heights_mm"])
    assert unknown > 0
    assert html.count('fill="#dfe3e6"') == unknown + len(board_type.components) - len(q["component_sigma_px"])
    found = stitched.result.surface
    assert found is not None
    assert "bow" in surface(stitched).html()
    flat = StitchedRun(
        stitched.opened, (), stitched.result.model_copy(update={"surface": None}), stitched.findings, {}, {}
    )
    assert "Not estimated" in surface(flat).html()


def test_vectors_are_the_links_of_the_adjustment(stitched: StitchedRun) -> None:
    count = stitched.result.quality["links"]
    rows = [vectors(stitched, i, "rows")[0] for i in range(stitched.cameras)]
    assert sum(map(len, rows)) == 2 * count["rows"]["used"], "both ends lie in frames of the camera"
    left, right = (vectors(stitched, i, "neighbours")[1] for i in range(2))
    assert len(left) == len(right) == count["neighbours"]["used"]
    assert left.mean(0) == pytest.approx(-right.mean(0), abs=0.01)
    assert "exaggerated" in residual_vectors(stitched).lead


def test_displaced_camera_is_corrected_and_leaves_no_seam(run: Path, tmp_path: Path) -> None:
    known = read_calibration(run / "calibration.json")
    off_mm = 0.12
    moved = known.camera_matrices[1] @ np.array([[1, 0, 0], [0, 1, off_mm], [0, 0, 1]])
    write_calibration(
        tmp_path / "calibration.json", known.model_copy(update={"camera_matrices": (known.camera_matrices[0], moved)})
    )
    stitched = restitch(open_run(run, calibration=tmp_path / "calibration.json"))
    left, right = (np.median(vectors(stitched, i, "neighbours")[1], axis=0) for i in range(2))
    assert max(np.hypot(*left), np.hypot(*right)) < 0.1
    one, other = (d[1] for d in stitched.result.quality["camera_displacement_px"])
    assert abs(other - one) == pytest.approx(off_mm * 18, rel=0.05), "18 px/mm; pictures do not show which one moved"


def test_tiles_are_placed_as_cameras_and_belt_predict(stitched: StitchedRun) -> None:
    corners, size = layout(stitched)
    assert set(corners) == set(stitched.opened.present)
    head, camera = stitched.head, stitched.opened.setup.cameras[0]
    wide = float(np.hypot(*(corners[0, 0][1] - corners[0, 0][0])))
    scale = wide / camera.width_px * camera.px_per_mm
    step_mm = (corners[0, 1] - corners[0, 0]).mean(0) / scale
    belt_mm = -np.array(head.conveyor_mm_s) * head.trigger_period_s
    assert step_mm == pytest.approx(belt_mm, abs=0.5)
    assert corners[1, 0].mean(0)[0] > corners[0, 0].mean(0)[0]
    everything = np.concatenate(list(corners.values()))
    assert everything.min() >= 0
    assert (everything.max(0) <= size).all()


def test_every_pair_is_an_edge_with_its_links(stitched: StitchedRun) -> None:
    html = tile_graph(stitched).html()
    linked = [p for p in stitched.pairs if len(p.links.a_px)]
    assert html.count(" links, correlation ") == len(linked)
    assert html.count("stroke-dasharray") == len(stitched.pairs) - len(linked)
    unlinked = stitched.result.quality["unlinked"]
    assert len(unlinked) == len(stitched.pairs) - len(linked)
    for entry in unlinked:
        assert entry["reason"] in html


def test_key_numbers_are_those_of_the_result(stitched: StitchedRun) -> None:
    html, q = key_numbers(stitched).html(), stitched.result.quality
    assert f"<dd>{q['residual_px']['median']:.3f} px</dd>" in html
    assert f"{q['links']['rows']['used']} used of {q['links']['rows']['found']}" in html
    present = len(stitched.opened.present)
    assert f"{present} of {present} delivered, {present} placed" in html


def test_unknown_values_are_dashes(stitched: StitchedRun) -> None:
    quality = stitched.result.quality | {
        "cad_sigma_px": None, "scale_error": None, "outline_contrast": None, "component_sigma_px": {},
        "belt": {"measured_mm_s": None, "nominal_mm_s": [0.0, 100.0], "speed_error": None},
    }  # fmt: skip
    result = stitched.result.model_copy(update={"quality": quality, "components": None})
    assert key_numbers(replace(stitched, result=result)).html().count("<dd>–</dd>") == 5


def test_deviations_agree_with_the_truth_within_their_uncertainty(stitched: StitchedRun, run: Path) -> None:
    true = [np.array(m) for m in json.loads((run / "truth.json").read_text())["row_motion"]]
    d = deviation(stitched.findings)
    times_s, pivot = stitched.head.row_times_s(), stitched.findings.adjusted.motion.pivot
    along = d.velocity_mm_s / np.hypot(*d.velocity_mm_s)
    across = np.array([-along[1], along[0]])
    for j, (m, held) in enumerate(zip(true, d.held, strict=True)):
        back = np.linalg.inv(m) @ (*pivot, 1.0)
        off = -(back[:2] - pivot) - d.velocity_mm_s * (times_s[j] - times_s[0])
        yaw_mrad = 1e3 * np.arctan2(m[1, 0], m[0, 0])
        expected = np.array([off @ along * 1e3, off @ across * 1e3, yaw_mrad])
        allowed = 4 * d.sigma[j] + (4.0, 4.0, 0.05)
        assert not held or (np.abs(d.value[j] - expected) <= allowed).all(), j
    assert d.value[0].tolist() == [0, 0, 0]
    assert d.sigma[0].tolist() == [0, 0, 0]
    assert (d.sigma[1:] > 0).all()


def with_quality(stitched: StitchedRun, **quality: Any) -> StitchedRun:
    """Return the run with other quality figures."""
    result = stitched.result.model_copy(update={"quality": stitched.result.quality | quality})
    return replace(stitched, result=result)


def test_one_seam_with_the_links_between_the_two_cameras(stitched: StitchedRun) -> None:
    html = seams(stitched).html()
    used = stitched.result.quality["links"]["neighbours"]["used"]
    assert html.count("<tr>") == 2
    assert f'<td>0 – 1</td><td class="n">{used}</td>' in html


def test_seam_without_links_is_reported(stitched: StitchedRun) -> None:
    assert "no links" in seams(replace(stitched, findings=replace(stitched.findings, links=()))).html()


def test_every_fiducial_is_a_row_and_every_detection_a_dot(stitched: StitchedRun) -> None:
    listed, html = stitched.result.quality["fiducials"], fiducials(stitched).html()
    for fiducial in listed:
        assert f"<td>{fiducial['name']}</td>" in html
    points = stitched.findings.problem.fiducials
    assert points is not None
    assert html.count('fill-opacity="0.75"') == int((points.which >= 0).sum())


def test_fiducial_that_was_not_found_has_no_residual(stitched: StitchedRun) -> None:
    absent = [{"name": "FID9", "sightings": 0, "residual_px": None}]
    html = fiducials(with_quality(stitched, fiducials=absent)).html()
    assert html.count('<td class="n">–</td>') == 3


def test_frame_without_links_is_marked(stitched: StitchedRun) -> None:
    assert "no links" not in frame_table(stitched).html()
    lonely = replace(stitched, findings=replace(stitched.findings, links=()))
    assert frame_table(lonely).html().count("no links") == len(stitched.opened.present)


def test_input_files_are_named_with_their_digests(stitched: StitchedRun, run: Path) -> None:
    html = identity(stitched).html()
    for name in ("recording.json", "calibration.json", "board.json"):
        assert digest(run / name) in html
    assert "<dt>reference</dt><dd>none</dd>" in html


def test_texts_cannot_end_the_script_element(stitched: StitchedRun) -> None:
    result = stitched.result.model_copy(update={"reasons": ("</script><script>alert(1)</script>",)})
    block = data_block(replace(stitched, result=result))
    assert block.count("</script>") == 1
    assert "alert(1)" in block
