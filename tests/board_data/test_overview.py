from __future__ import annotations

from pathlib import Path

import pytest

from tests.board_data.readers import samples
from vaoi_station.board_data import read_design, to_board_type
from vaoi_station.board_data.import_process import ImportTask, run_import
from vaoi_station.board_data.overview import ImportOverview, overview


def of(path: Path, text: str) -> ImportOverview:
    path.write_text(text)
    design = read_design(path)
    return overview(design, *to_board_type(design, "top"))


def test_a_board_file_lacks_heights_and_a_fiducial(tmp_path: Path) -> None:
    found = of(tmp_path / "b.kicad_pcb", samples.KICAD)
    assert (found.parts_top, found.parts_bottom, found.components, found.cut_outs) == (3, 1, 3, 1)
    assert found.size_mm == pytest.approx((50, 45), abs=0.01)
    assert [(m.what, m.count) for m in found.missing] == [("fiducials", 1), ("heights", 3)]
    assert found.table is None


def test_a_table_shows_its_columns_and_what_it_has_no_column_for(tmp_path: Path) -> None:
    found = of(tmp_path / "p.csv", "Name;Mid X (mm);Mid Y (mm)\nR1;1;2\nFID1;0;0\nFID2;30;30\n")
    assert found.table is not None
    assert [(c.name, c.number, c.header) for c in found.table.columns] == [
        ("ref", 1, "Name"),
        ("x", 2, "Mid X (mm)"),
        ("y", 3, "Mid Y (mm)"),
    ]
    assert [m.what for m in found.missing] == ["outline", "sizes", "heights", "sides", "rotations"]
    assert found.sizes_from == {"guess": 3}
    stated = run_import(ImportTask(file=tmp_path / "p.csv", side="bottom", columns="side=bottom")).overview
    assert stated is not None
    assert (stated.parts_bottom, stated.table and stated.table.all_on) == (3, "bottom")
    assert "sides" not in [m.what for m in stated.missing]
