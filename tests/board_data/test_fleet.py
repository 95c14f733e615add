"""The count of a fleet of board data: each file has one outcome, and refusals of a kind are one entry."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.board_data import fleet as module
from tests.board_data.fleet import Fleet, files_in
from tests.board_data.readers import samples

BOARD = """(kicad_pcb (version 20240108) (generator "x")
  (gr_rect (start 0 0) (end 40 30) (layer "Edge.Cuts"))
  {parts})
"""
PART = """(footprint "R_0402" (layer "{layer}") (at 10 10) (property "Reference" "R{n}" (at 0 0))
  (pad "1" smd rect (at 0 0) (size 1 0.5) (layers "F.Cu")))"""


def test_each_file_has_an_outcome_and_refusals_are_classified(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, count in (("empty", 0), ("bare", 0), ("board", 2)):
        parts = "".join(PART.format(n=n, layer=layer) for n, layer in zip(range(count), ("F.Cu", "B.Cu"), strict=False))
        (tmp_path / f"{name}.kicad_pcb").write_text(BOARD.format(parts=parts))
    fleet = Fleet()
    for format, path in files_in(tmp_path):
        fleet.add(format, path)
    seen = fleet.formats["KiCad"]
    assert (seen.files, dict(seen.outcomes)) == (3, {"refused": 2, "warned": 1})
    assert (seen.sides, seen.components, seen.fiducials, seen.outlines) == (2, 2, 0, 2)
    [(sentence, files)] = fleet.refusals.items()
    assert "has no part on the top" in sentence
    assert len(files) == 2

    def broken(path: Path) -> None:
        raise IndexError(str(path.name))

    monkeypatch.setattr(module, "read_design", broken)
    assert fleet.add("KiCad", tmp_path / "board.kicad_pcb") == "crash"
    assert any(line.startswith("1 × CRASH: IndexError") for line in fleet.lines())


def test_pins_that_fit_are_counted_for_each_side(tmp_path: Path) -> None:
    (tmp_path / "b.xml").write_text(samples.IPC2581)
    fleet = Fleet()
    assert fleet.add("IPC-2581", tmp_path / "b.xml") == "warned"
    assert "| IPC-2581 | bottom | 1 | 1 |" in fleet.lines()
    assert not any(line.startswith("| IPC-2581 | top") for line in fleet.lines())
