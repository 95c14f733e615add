"""An archived run is opened as its station stitched it; what keeps the result from being equal is named."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from vaoi_station import RecordedRun
from vaoi_station.errors import InputError
from vaoi_station.line_config import ExpectedBoard
from vaoi_station.model.board_type import Visibility
from vaoi_station.plant.restitch.opening import open_archived
from vaoi_station.plant.restitch.terms import Terms
from vaoi_station.stitching.expectation import StitchTerms

TERMS = StitchTerms(
    leading_edge_mm=3.0,
    conveyor_mm_s=(0.0, 100.0),
    expected_board=ExpectedBoard(rail_mm=1.0),
    visibility=Visibility(coverage=0.5),
    channels={},
)


def extracted(board: RecordedRun, folder: Path, made: dict[str, Any] | None, *, reference: bool = False) -> Path:
    """Copy the board's recording with the record of a station, and itself as its reference."""
    run = Path(shutil.copytree(board.directory, folder / "run"))
    record = {"id": "r", "started": "2026-03-01T08:00:00Z", "made_with": made}
    (run / "run.json").write_text(json.dumps(record), encoding="utf-8")
    if reference:
        shutil.copytree(board.directory, run / "reference")
    return run


def test_method_and_terms_are_those_of_the_station(board: RecordedRun, tmp_path: Path) -> None:
    run = extracted(board, tmp_path, {"method": "fiducials", "terms": TERMS.model_dump(mode="json")})
    opened, notes = open_archived(run, tmp_path, Terms("any"))
    setup = opened.setup
    assert (setup.method, setup.visibility, notes) == ("fiducials", TERMS.visibility, [])
    assert setup.expectation.corner_mm[0] == 1.0
    assert open_archived(run, tmp_path, Terms("any", method="features"))[0].setup.method == "features"


def test_a_record_without_terms_is_named(board: RecordedRun, tmp_path: Path) -> None:
    _, notes = open_archived(extracted(board, tmp_path, None), tmp_path, Terms("any"))
    assert notes == ["Its station did not state where it expected the board, and what of it was to be seen."]


@pytest.mark.parametrize("method", ["auto", "reference"])
def test_a_reference_that_is_absent_is_named(board: RecordedRun, method: str, tmp_path: Path) -> None:
    made = {"method": method, "reference": "taught", "terms": TERMS.model_dump(mode="json")}
    run = extracted(board, tmp_path, made)
    if method == "reference":
        with pytest.raises(InputError, match="needs a reference"):
            open_archived(run, tmp_path, Terms("any"))
    else:
        opened, notes = open_archived(run, tmp_path, Terms("any"))
        assert opened.reference is None
        assert notes == [
            "The reference taught, against which its station placed the board, is not in the archive."
        ]  # fmt: skip


def test_another_calibration_holds_for_the_reference_too(
    board: RecordedRun, moved_calibration: Path, tmp_path: Path
) -> None:
    made = {"method": "auto", "reference": "taught", "terms": TERMS.model_dump(mode="json")}
    run = extracted(board, tmp_path, made, reference=True)
    opened, notes = open_archived(run, tmp_path, Terms("any", calibration=moved_calibration.read_bytes()))
    assert (opened.reference is not None, notes) == (True, [])


def test_a_reference_of_another_board_type_is_not_used(board: RecordedRun, tmp_path: Path) -> None:
    made = {"method": "auto", "reference": "taught", "terms": TERMS.model_dump(mode="json")}
    run = extracted(board, tmp_path, made, reference=True)
    other = json.loads((run / "board.json").read_text(encoding="utf-8"))
    other["components"] = other["components"][1:]
    (run / "reference" / "board.json").write_text(json.dumps(other), encoding="utf-8")
    opened, notes = open_archived(run, tmp_path, Terms("any"))
    assert opened.reference is None
    assert "is not used" in notes[0]
    assert "whose components are not those of" in notes[0]
