"""`vaoi heights` from the outside: heights of the twin's bodies, and refusals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from vaoi_station.files.images import read_image


def test_heights_agree_with_the_truth_of_the_twin(vaoi: Any, case: tuple[Path, Path], tmp_path: Path) -> None:
    run, result = case
    out = tmp_path / "heights.json"
    said = vaoi("heights", run, "--result", result, "--out", out)
    assert (said.code, said.err) == (0, "")
    found = json.loads(out.read_text())
    truth = json.loads((run / "truth.json").read_text())["heights"]
    assert f"{len(found)} component(s): " in said.out
    tall = {ref: entry for ref, entry in found.items() if truth[ref] >= 0.5 and entry["views"] >= 2}
    sure = {ref: e for ref, e in tall.items() if e["height_mm"] is not None and e["sigma_mm"] <= 0.15}
    assert len(sure) >= 0.75 * len(tall)
    error = np.array([entry["height_mm"] - truth[ref] for ref, entry in sure.items()])
    assert np.median(np.abs(error)) < 0.05
    assert np.percentile(np.abs(error), 90) < 0.15
    assert set(found["U1"]) >= {"height_mm", "sigma_mm", "views"}


def test_a_result_of_another_recording_and_an_overwritten_input_are_refused(
    vaoi: Any, case: tuple[Path, Path], tmp_path: Path
) -> None:
    run, result = case
    document = json.loads(result.read_text())
    document["row_motion"] = document["row_motion"][:-1]
    document["image_matrices"] = [rows[:-1] for rows in document["image_matrices"]]
    (tmp_path / "other.json").write_text(json.dumps(document))
    said = vaoi("heights", run, "--result", tmp_path / "other.json", "--out", tmp_path / "heights.json")
    assert said.code == 2
    assert "5 rows, the recording has 2 cameras and 6 rows" in said.err
    said = vaoi("heights", run, "--result", result, "--out", result)
    assert said.code == 2
    assert "is read by this command" in said.err


def test_a_map_is_written_beside_the_heights_and_a_region_off_the_board_is_refused(
    vaoi: Any, case: tuple[Path, Path], tmp_path: Path
) -> None:
    run, result = case
    part = next(c for c in json.loads((run / "board.json").read_text())["components"] if c["ref"] == "U2")
    (x, y), w, h = part["center"], part["width"] / 2, part["height"] / 2
    out, region = tmp_path / "heights.json", (x - w, y - h, x + w, y + h)
    said = vaoi("heights", run, "--result", result, "--out", out, "--map", *region)
    assert (said.code, said.err) == (0, "")
    heights, sigma = (cv2.imread(str(tmp_path / f"heights.map{name}.tiff"), -1) for name in ("", "-sigma"))
    assert heights is not None
    assert sigma is not None
    assert heights.dtype == np.float32
    assert heights.shape == sigma.shape
    middle = heights[heights.shape[0] // 3 : -(heights.shape[0] // 3), heights.shape[1] // 3 : -(heights.shape[1] // 3)]
    truth = json.loads((run / "truth.json").read_text())["heights"]["U2"]
    assert np.nanmedian(middle) == pytest.approx(truth, abs=0.15)
    assert read_image(tmp_path / "heights.map.png").ndim == 3
    assert "image_from_cad" in json.loads((tmp_path / "heights.map.json").read_text())
    said = vaoi("heights", run, "--result", result, "--out", tmp_path / "no.json", "--map", 900, 900, 910, 910)
    assert said.code == 2
    assert "region is [900.0, 900.0, 910.0, 910.0]" in said.err
    assert "must be on the board" in said.err
    assert not (tmp_path / "no.json").exists()


def test_flat_fields_of_another_array_are_refused(vaoi: Any, case: tuple[Path, Path], tmp_path: Path) -> None:
    run, result = case
    said = vaoi("heights", run, "--result", result, "--out", tmp_path / "h.json", "--flatfield", tmp_path / "none")
    assert said.code == 2
    assert "flatfield.json" in said.err
