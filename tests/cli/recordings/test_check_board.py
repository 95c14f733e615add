"""`vaoi check-board` from the outside, with the twin's board and wrong data."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from vaoi_station.files.images import read_image


def test_shifted_and_mirrored_data_are_corrected_to_those_of_the_twin(
    vaoi: Any, case: tuple[Path, Path], tmp_path: Path
) -> None:
    run, result = case
    truth = json.loads((run / "board.json").read_text())
    wrong = json.loads(json.dumps(truth))
    for part in wrong["components"]:
        part["center"] = [48.0 - part["center"][0], part["center"][1] + 1.5]
        part["rotation"] = 180 - part["rotation"]
    (tmp_path / "wrong.json").write_text(json.dumps(wrong | {"outline": None}))
    out, corrected, picture = tmp_path / "check.json", tmp_path / "corrected.json", tmp_path / "check.png"
    said = vaoi(
        "check-board", run, "--result", result, "--board-type", tmp_path / "wrong.json", "--out", out,
        "--corrected", corrected, "--revision", "C", "--picture", picture,
    )  # fmt: skip
    assert (said.code, said.err) == (0, "")
    assert "check: the components lie mirrored" in said.out
    report = json.loads(out.read_text())
    assert report["format"] == "vaoi-board-check"
    assert report["moved"] == ["components"], "the fiducials are where they are stated"
    proposal = json.loads(corrected.read_text())
    assert (proposal["state"], proposal["revision"]) == ("draft", "C")
    pairs = list(zip(proposal["components"], truth["components"], strict=True))
    assert max(math.dist(a["center"], b["center"]) for a, b in pairs) < 0.03
    assert {round(a["rotation"] - b["rotation"]) % 360 for a, b in pairs} == {0}
    assert read_image(picture).ndim == 3
    again = vaoi("check-board", run, "--result", result, "--board-type", run / "board.json", "--out", out)
    assert again.code == 2
    assert "exists" in again.err


def test_right_data_leave_nothing_to_correct(vaoi: Any, case: tuple[Path, Path], tmp_path: Path) -> None:
    run, result = case
    said = vaoi(
        "check-board", run, "--result", result, "--board-type", run / "board.json", "--corrected", tmp_path / "c.json"
    )
    assert said.code == 3
    assert "nothing to correct" in said.out
    assert "nothing to correct" in said.err
    assert not (tmp_path / "c.json").exists()
