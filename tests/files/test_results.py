"""Read and write results."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.errors import InputError
from vaoi_station.files import read_stitch, write_stitch
from vaoi_station.files.documents import read_json
from vaoi_station.files.results import read_heights, stitch_document, stitch_text
from vaoi_station.model import BoardType

Write = Callable[..., Path]
EYE = np.eye(3).tolist()


@pytest.fixture
def document() -> dict[str, Any]:
    """One camera, two rows, the second of them unplaced."""
    return {
        "format": "vaoi-stitch",
        "version": 1,
        "method": "row-joint",
        "image_matrices": [[[[40.0, 0.0, 600.0], [0.0, 40.0, 500.0], [0.0, 0.0, 1.0]], None]],
        "cad_matrix": None,
        "row_motion": [EYE, [[1.0, 0.0, 0.0], [0.0, 1.0, 12.5], [0.0, 0.0, 1.0]]],
        "status": "degraded",
        "reasons": ["row 1 shows nothing"],
        "reason_codes": ["rows-not-connected"],
        "quality": {"rms_px": 0.02, "rows": [{"sd": 0.01}, None]},
    }


def test_optional_keys_round_trip(tmp_path: Path, write: Write, document: dict[str, Any]) -> None:
    surface = {
        "lift_mm": 0.1,
        "tilt_mm": [0.0, 0.1],
        "bow_mm": [0.1, 0.0, 0.2],
        "about": [1.0, 2.0],
        "half_span": [3.0, 4.0],
    }
    document |= {"surface": surface, "components": {"U1": [[0, 0, 1.5, 2.5]]}, "cad_matrix": EYE, "x_run": 7}
    document |= {"camera_matrices": [EYE]}
    write_stitch(tmp_path / "again.json", read_stitch(write(document)))
    assert read_json(tmp_path / "again.json") == document


@pytest.mark.parametrize("name", ["U1", "NaN", "-Infinity", "Gehäuse ½"])
def test_text_and_document_of_a_result_agree(write: Write, document: dict[str, Any], name: str) -> None:
    document |= {"components": {name: [[0, 0, 1e-5, 2.5e-21]]}, "x_run": 7}
    stitch = read_stitch(write(document))
    assert json.loads(stitch_text(stitch)) == stitch_document(stitch) == document
    bare = read_stitch(write({k: v for k, v in document.items() if k != "components"}))
    assert json.loads(stitch_text(bare)) == stitch_document(bare)


@pytest.mark.parametrize("number", [float("nan"), float("inf"), -float("inf")])
def test_numbers_that_json_cannot_hold_are_refused(write: Write, document: dict[str, Any], number: float) -> None:
    stitch = read_stitch(write(document))
    with pytest.raises(ValueError, match="not JSON compliant"):
        stitch_text(stitch.model_copy(update={"quality": {"rms_px": [number]}}))
    with pytest.raises(ValueError, match="not JSON compliant"):
        stitch_text(stitch.model_copy(update={"components": {"U1": ((0, 0, number, 1.0),)}}))


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"version": 3}, "version is 3, but must be 1. Use a newer"),
        ({"format": "vaoi-recording"}, "format is 'vaoi-recording'"),
        ({"status": "fine"}, "status: "),
        ({"image_matrices": [[EYE, None], [EYE]]}, r"image_matrices has cameras of \[1, 2\] rows"),
        ({"row_motion": [EYE]}, "row_motion has 1 entries, must have one per row: 2"),
        ({"image_matrices": [[EYE, [[1, 2], [3, 4]]]]}, r"image_matrices\.0\.1: has shape \(2, 2\)"),
        ({"verdict": 1}, r"unknown key\(s\) 'verdict'"),
    ],
)
def test_faulty_documents_are_refused_with_file_and_key(
    write: Write, document: dict[str, Any], change: dict[str, Any], complaint: str
) -> None:
    with pytest.raises(InputError, match=rf"document\.json: (.*: )?{complaint}"):
        read_stitch(write(document | change))


PARTS = BoardType.model_validate(
    {"name": "b", "components": [{"ref": ref, "center": [1, 1], "width": 1, "height": 1} for ref in ("U1", "C7")]}
)
MEASURED = {"height_mm": 1.4, "sigma_mm": 0.01, "views": 4}
INTERVAL = {"height_mm": None, "sigma_mm": None, "views": 2, "low_mm": 0.3, "high_mm": 1.9}
AMBIGUOUS = INTERVAL | {"intervals": [{"low_mm": 0.3, "high_mm": 0.5, "probability": 0.9}]}


def test_measured_heights_are_read_from_files_and_replies(write: Write) -> None:
    for other in (INTERVAL, AMBIGUOUS):
        entries = {"U1": MEASURED, "C7": other}
        assert read_heights(write({"heights": entries}), PARTS) == {"U1": (1.4, 0.01)}
    for document in (entries, {"heights": entries}):
        assert read_heights(write(document), PARTS) == {"U1": (1.4, 0.01)}


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ([1], "holds a list, must be an object of heights by component"),
        ({"U9": MEASURED}, "has a height of 'U9', which board type 'b' does not have"),
        ({"U1": MEASURED | {"sigma_mm": -1}}, "U1: sigma_mm: Input should be greater than 0"),
        ({"U1": 1.4}, "U1: the document: Input should be a valid dictionary"),
    ],
)
def test_other_documents_are_not_heights(write: Write, document: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read_heights(write(document), PARTS)
