"""The sections of the report."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.files import read_calibration, write_calibration
from vaoi_station.geometry import Camera, Lens, Projective, System
from vaoi_station.model import BoardType
from vaoi_station.reporting import StitchedRun, restitch
from vaoi_station.reporting.figures import (
    data_block,
    detection_arrays,
    deviation,
    digest,
    document,
    fiducials,
    frame_table,
    head,
    identity,
    key_numbers,
    link_arrays,
    links_of,
    picture_id,
    picture_store,
    row_motion,
    seams,
    timings,
)
from vaoi_station.reporting.maps import (
    BoardDrawing,
    Vectors,
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


def test_cells_lie_inside_the_outline() -> None:
    triangle = BoardType.model_validate({"name": "t", "outline": [[0, 0], [30, 0], [0, 30]]})
    centres, side = BoardDrawing(triangle).cells()
    assert (centres.sum(1) <= 30 + 1e-9).all()
    assert len(centres) * side**2 == pytest.approx(450, rel=0.1)


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
    rows = [vectors(stitched, i, "rows") for i in range(stitched.cameras)]
    assert sum(v.links for v in rows) == count["rows"]["used"]
    assert [len(v.at_px) for v in rows] == [2 * v.links for v in rows], "both ends lie in frames of the camera"
    sides = [vectors(stitched, i, "neighbours") for i in range(2)]
    assert [v.links for v in sides] == [count["neighbours"]["used"]] * 2
    assert sides[0].off_px.mean(0) == pytest.approx(-sides[1].off_px.mean(0), abs=0.01)
    assert "exaggerated" in residual_vectors(stitched).lead


def test_displaced_camera_is_corrected_and_leaves_no_seam(run: Path, tmp_path: Path) -> None:
    known = read_calibration(run / "calibration.json")
    off_mm = 0.12
    moved = known.camera_matrices[1] @ np.array([[1, 0, 0], [0, 1, off_mm], [0, 0, 1]])
    write_calibration(
        tmp_path / "calibration.json", known.model_copy(update={"camera_matrices": (known.camera_matrices[0], moved)})
    )
    stitched = restitch(open_run(run, calibration=tmp_path / "calibration.json"))
    left, right = (np.median(vectors(stitched, i, "neighbours").off_px, axis=0) for i in range(2))
    assert max(np.hypot(*left), np.hypot(*right)) < 0.1
    one, other = (d[1] for d in stitched.result.quality["camera_displacement_px"])
    assert abs(other - one) == pytest.approx(off_mm * 18, rel=0.05), "18 px/mm; pictures do not show which one moved"


def test_means_are_taken_per_cell() -> None:
    camera = Camera(140, 140, Projective(np.eye(3), System.IMAGE, System.ROW), Lens((0.0, 0.0), 1.0))
    v = Vectors(np.array([[1.0, 1], [3, 3], [101, 51]]), np.array([[1.0, 0], [0, 1], [5, 5]]))
    m = v.means(camera)
    assert m.at_px.tolist() == [[2, 2], [101, 51]]
    assert m.off_px.tolist() == [[0.5, 0.5], [5, 5]]
    assert Vectors(np.zeros((0, 2)), np.zeros((0, 2))).means(camera).rms_px is None


def test_tiles_are_placed_as_cameras_and_belt_predict(stitched: StitchedRun) -> None:
    plan = layout(stitched)
    assert set(plan.corners) == set(stitched.opened.present)
    head, camera = stitched.head, stitched.opened.setup.cameras[0]
    wide = float(np.hypot(*(plan.corners[0, 0][1] - plan.corners[0, 0][0])))
    scale = wide / camera.width_px * camera.px_per_mm
    step_mm = (plan.middle((0, 1)) - plan.middle((0, 0))) / scale
    belt_mm = -np.array(head.conveyor_mm_s) * head.trigger_period_s
    assert step_mm == pytest.approx(belt_mm, abs=0.5)
    assert plan.middle((1, 0))[0] > plan.middle((0, 0))[0]
    everything = np.concatenate(list(plan.corners.values()))
    assert everything.min() >= 0
    assert everything[:, 0].max() <= plan.width
    assert everything[:, 1].max() <= plan.height


def test_every_pair_is_an_edge_with_its_links(stitched: StitchedRun) -> None:
    html = tile_graph(stitched).html()
    linked = [p for p in stitched.pairs if len(p.links.a_px)]
    assert html.count(" links, correlation ") == len(linked)
    assert html.count("stroke-dasharray") == len(stitched.pairs) - len(linked)
    unlinked = stitched.result.quality["unlinked"]
    assert len(unlinked) == len(stitched.pairs) - len(linked)
    for entry in unlinked:
        assert entry["reason"] in html


def test_head_shows_verdict_size_and_method(stitched: StitchedRun) -> None:
    html = head(stitched, "run <1>")
    assert "<h1>run &lt;1&gt;" in html
    assert '<span class="verdict">ok</span>' in html
    assert f"2 cameras × {stitched.head.rows} rows · method auto" in html
    assert "<ul>" not in html


def test_reasons_are_listed(stitched: StitchedRun) -> None:
    result = stitched.result.model_copy(update={"reasons": ("a < b", "second")})
    assert head(replace(stitched, result=result), "r").endswith("<ul><li>a &lt; b</li><li>second</li></ul></header>")


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


def test_every_row_is_a_point_with_its_numbers(stitched: StitchedRun) -> None:
    html = row_motion(stitched).html()
    assert html.count("<circle") == 3 * stitched.head.rows
    assert f"row {stitched.head.rows - 1}: " in html


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


def test_board_that_was_not_found_is_reported(stitched: StitchedRun) -> None:
    assert "The board was not found." in fiducials(with_quality(stitched, fiducials=[])).html()


def test_every_thumbnail_is_defined_once_and_used_by_its_frame(stitched: StitchedRun) -> None:
    store, html = picture_store(stitched), frame_table(stitched).html()
    for key in stitched.opened.present:
        assert store.count(f'id="{picture_id(key)}"') == 1
        assert html.count(f'href="#{picture_id(key)}"') == 1


def test_both_frames_of_a_link_count_it(stitched: StitchedRun) -> None:
    links = links_of(stitched)
    assert sum(links.values()) == 2 * sum(pair.used for pair in stitched.pairs)
    assert set(links) <= set(stitched.opened.present)


def test_frame_without_links_is_marked(stitched: StitchedRun) -> None:
    assert "no links" not in frame_table(stitched).html()
    lonely = replace(stitched, findings=replace(stitched.findings, links=()))
    assert frame_table(lonely).html().count("no links") == len(stitched.opened.present)


def test_frames_that_are_not_ok_are_listed_with_their_cause(stitched: StitchedRun) -> None:
    head = stitched.head.model_copy(update={"missing": ((0, 1),)})
    recording = replace(stitched.opened.recording, head=head)
    html = frame_table(replace(stitched, opened=replace(stitched.opened, recording=recording))).html()
    assert "frames that are not ok: 1" in html
    assert html.count("the frame was not delivered") == 2


def test_digest_is_the_first_half_of_the_files_sha_256(tmp_path: Path) -> None:
    path = tmp_path / "board.json"
    path.write_bytes(b"{}")
    assert digest(path) == f"board.json · {hashlib.sha256(b'{}').hexdigest()[:16]}"


def test_input_files_are_named_with_their_digests(stitched: StitchedRun, run: Path) -> None:
    html = identity(stitched).html()
    for name in ("recording.json", "calibration.json", "board.json"):
        assert digest(run / name) in html
    assert "<dt>reference</dt><dd>none</dd>" in html


def test_unknown_values_are_reported_as_such(stitched: StitchedRun) -> None:
    calibration = stitched.opened.calibration.model_copy(update={"created": None, "working_distance_mm": None})
    html = identity(replace(stitched, opened=replace(stitched.opened, calibration=calibration))).html()
    assert "not stated" in html
    assert "not known" in html


def test_every_task_and_stage_has_a_time(stitched: StitchedRun) -> None:
    rows = timings(stitched).html().count("<tr>") - 1
    assert rows == len(stitched.task_ms) + len(stitched.result.quality["timings_ms"])


def test_document_round_trips_through_the_script_element(stitched: StitchedRun) -> None:
    block = data_block(stitched)
    content = block.removeprefix('<script type="application/json" id="run">').removesuffix("</script>")
    assert json.loads(content) == json.loads(json.dumps(document(stitched)))


def test_texts_cannot_end_the_script_element(stitched: StitchedRun) -> None:
    result = stitched.result.model_copy(update={"reasons": ("</script><script>alert(1)</script>",)})
    block = data_block(replace(stitched, result=result))
    assert block.count("</script>") == 1
    assert "alert(1)" in block


def test_links_lie_in_their_frames_and_have_positive_information(stitched: StitchedRun) -> None:
    arrays = link_arrays(stitched)
    assert len({len(values) for values in arrays.values()}) == 1
    head = stitched.head
    for frame, px in ((arrays["a"], arrays["a_px"]), (arrays["b"], arrays["b_px"])):
        assert (frame >= 0).all()
        assert (frame < (len(head.cameras), head.rows)).all()
        assert (px > -0.5).all()
        assert (px < (head.cameras[0].width, head.cameras[0].height)).all()
    assert (np.linalg.eigvalsh(arrays["information"]) > 0).all()
    assert ((arrays["a"][:, 0] != arrays["b"][:, 0]) == (arrays["between_cameras"] == 1)).all()


def test_detections_have_one_entry_each(stitched: StitchedRun) -> None:
    arrays = detection_arrays(stitched)
    assert len({len(values) for values in arrays.values()}) == 1
    assert len(arrays["px"]) > 0
    assert (arrays["sigma_px"] > 0).all()


def test_numbers_have_six_significant_digits(stitched: StitchedRun) -> None:
    data, arrays = document(stitched), link_arrays(stitched)
    assert data["links"]["component"] == arrays["component"].tolist()
    np.testing.assert_allclose(data["links"]["a_px"], arrays["a_px"], rtol=1e-5)
    assert all(len(f"{x:.12g}".replace(".", "").lstrip("0")) <= 6 for x, _ in data["links"]["a_px"])
