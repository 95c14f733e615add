"""`vaoi identify` from the outside: a code of the twin, agreement, difference, and refusals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.identity.conftest import DATAMATRIX
from vaoi_station.files.results import write_stitch
from vaoi_station.model import Status, Stitch
from vaoi_station.simulation import Scenario, Twin
from vaoi_station.simulation.recording_writer import write_passage


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A recording of a small board with a code, and its result from the truth."""
    return record(tmp_path_factory.mktemp("identify"), DATAMATRIX)


def record(folder: Path, code: dict[str, Any]) -> tuple[Path, Path]:
    scenario = {
        "array": {"cameras": 1, "width_px": 320, "height_px": 240, "px_per_mm": 16.0, "working_distance_mm": 250.0},
        "board": {"name": "coded", "width_mm": 18.0, "length_mm": 16.0, "density": 0.0, "codes": [code]},
        "line": {"barrier_mm": -15.0, "start_delay_s": 0.1, "period_s": 0.04, "tail_s": 0.1},
    }
    passage = Twin(Scenario.model_validate(scenario)).passage(41)
    truth = passage.truth()
    write_passage(passage, folder / "run")
    keys = ("image_matrices", "cad_matrix", "row_motion")
    write_stitch(folder / "result.json", Stitch(method="auto", status=Status.OK, **{key: truth[key] for key in keys}))
    return folder / "run", folder / "result.json"


def test_code_is_printed_and_compared(vaoi: Any, case: tuple[Path, Path], tmp_path: Path) -> None:
    run, result = case
    said = vaoi("identify", run, "--result", result, "--expect", "SN000042", "--out", tmp_path / "identity.json")
    assert (said.code, said.err) == (0, "")
    first, last = said.out.splitlines()
    assert first.startswith("datamatrix 'coded;SN000042' at (")
    assert first.endswith(" 0 % of the error correction used")
    assert last == "identity: agrees, board 'SN000042'"
    document = json.loads((tmp_path / "identity.json").read_text())
    assert (document["state"], document["codes"][0]["symbology"]) == ("agrees", "datamatrix")
    said = vaoi("identify", run, "--result", result, "--expect", "SN1")
    assert said.code == 0
    assert "board-id-differs: The board's code states 'SN000042', the line was armed with 'SN1'." in said.out
    assert "identity: differs" in said.out


def test_code_of_dots_is_read(vaoi: Any, tmp_path: Path) -> None:
    run, result = record(tmp_path, {**DATAMATRIX, "dot_modules": 0.7, "module_mm": 0.4, "inverted": True})
    said = vaoi("identify", run, "--result", result, "--expect", "SN000042")
    assert said.out.splitlines()[-1] == "identity: agrees, board 'SN000042'"


def test_board_type_without_identity_is_searched_everywhere(vaoi: Any, case: tuple[Path, Path], tmp_path: Path) -> None:
    run, result = case
    board = json.loads((run / "board.json").read_text())
    del board["identity"]
    (tmp_path / "board.json").write_text(json.dumps(board))
    said = vaoi("identify", run, "--result", result, "--board", tmp_path / "board.json")
    assert "identity: not-compared, board 'coded;SN000042'" in said.out


def test_input_is_not_overwritten(vaoi: Any, case: tuple[Path, Path]) -> None:
    run, result = case
    said = vaoi("identify", run, "--result", result, "--out", result)
    assert said.code == 2
    assert "is read by this command and is not overwritten" in said.err
