"""The numbers inside the report."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from vaoi_station.reporting import StitchedRun
from vaoi_station.reporting.sections.embedded_data import data_block, detection_arrays, document, link_arrays


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
