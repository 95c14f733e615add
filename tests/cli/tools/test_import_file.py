"""`vaoi import` with board data; with exported runs: tests/cli/station/test_export.py."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.board_data.readers import samples
from tests.cli.conftest import Result
from vaoi_station.board_data import import_process
from vaoi_station.board_data.import_process import ImportLimits

Vaoi = Callable[..., Result]


@pytest.fixture
def board(tmp_path: Path) -> Path:
    path = tmp_path / "b.kicad_pcb"
    path.write_text(samples.KICAD)
    return path


def test_a_board_type_is_written_and_what_to_check_is_printed(vaoi: Vaoi, board: Path, tmp_path: Path) -> None:
    out = tmp_path / "board.json"
    done = vaoi("import", str(board), "--out", str(out), "--name", "p-1")
    assert done.code == 0
    assert "top of 'p-1' (kicad): 3 components, 3 sizes from the file; 1 fiducials" in done.out
    assert "check: 1 fiducials found on the top; two are needed to stitch." in done.out
    document = json.loads(out.read_text())
    assert [c["ref"] for c in document["components"]] == ["R1", "J1", "FID1"]
    again = vaoi("import", str(board), "--out", str(out))
    assert (again.code, "exists" in again.err) == (2, True)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--side", "left"], "the side is 'left', but must be top or bottom"),
        (["--units", "cm"], "the unit is 'cm'"),
        (["--format", "odb"], "is no readable folder, zip or tar file"),
        (
            ["--repeat", "2x2"],
            "--repeat 2x2 needs --pitch, two lengths in mm such as 30x28.5, from board to board along x",
        ),
    ],
)
def test_wrong_options_are_refused(vaoi: Vaoi, board: Path, tmp_path: Path, options: list[str], message: str) -> None:
    done = vaoi("import", str(board), "--out", str(tmp_path / "x.json"), *options)
    assert (done.code, message in done.err) == (2, True), done.err
    assert not (tmp_path / "x.json").exists()


def test_a_file_that_exceeds_the_limits_of_an_import_is_refused(
    vaoi: Vaoi, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(import_process, "OF_PERSONS", ImportLimits(memory_bytes=400 * 2**20, advice="Try a part."))
    bomb = tmp_path / "bomb.zip"
    bomb.write_bytes(samples.odb_zip(samples.ODB | {"job/steps/pcb/eda/data": "PKG A 0 0 0 1 1;\n" * 3_000_000}))
    done = vaoi("import", str(bomb), "--out", str(tmp_path / "x.json"))
    assert (done.code, "the file is refused. Try a part." in done.err) == (2, True), done.err


def test_without_out_it_is_refused(vaoi: Vaoi, board: Path) -> None:
    done = vaoi("import", str(board))
    assert (done.code, "Give it by --out board.json." in done.err) == (2, True)


def test_places_and_bodies_of_two_files_are_joined(vaoi: Vaoi, board: Path, tmp_path: Path) -> None:
    placer, out = tmp_path / "p.csv", tmp_path / "board.json"
    placer.write_text("Ref,X(mm),Y(mm),Rot\nR1,110,10,0\nJ1,130,20,90\nFID1,105,5,0\n")
    done = vaoi("import", str(placer), "--join", str(board), "--out", str(out))
    assert done.code == 0, done.err
    assert "rotated by 0° and shifted by (100.000, 0.000) mm; 3 agree within 0 µm" in done.out
    document = json.loads(out.read_text())
    assert {c["ref"]: c["width"] for c in document["components"]} == {"R1": 2.0, "J1": 7.5, "FID1": 1.2}
    assert min(x for x, _ in document["outline"]) == 100


def test_panels_of_the_file_or_of_the_user(vaoi: Vaoi, board: Path, tmp_path: Path) -> None:
    (tmp_path / "b.zip").write_bytes(samples.odb_zip(samples.ODB | samples.ODB_PANEL))
    done = vaoi("import", str(tmp_path / "b.zip"), "--step", "panel", "--out", str(tmp_path / "a.json"))
    assert "check: step panel is a panel of 4 boards: 4 of step pcb; their positions count from 1." in done.out
    grid = ("--repeat", "2x1", "--pitch", "60x0", "--rotate", "0,180", "--border", "5x5")
    done = vaoi("import", str(board), *grid, "--out", str(tmp_path / "b.json"))
    assert (done.code, "6 components" in done.out) == (0, True), done.err
    for name, refs in (("a", {"1/R1", "4/C1"}), ("b", {"1/R1", "2/J1"})):
        document = json.loads((tmp_path / f"{name}.json").read_text())
        assert {f"{c['panel']}/{c['ref']}" for c in document["components"]} >= refs


def test_a_table_of_sizes_may_have_a_byte_order_mark(vaoi: Vaoi, tmp_path: Path) -> None:
    places, sizes = tmp_path / "places.csv", tmp_path / "sizes.toml"
    places.write_bytes("Designator,Footprint,X (mm),Y (mm),Rotation,Layer\nK1,MY-RELAY,1,2,0,top\n".encode("utf-8-sig"))
    sizes.write_bytes("[[package]]\npattern = '^MY-RELAY'\nsize = [15.0, 7.5]\n".encode("utf-16"))
    done = vaoi("import", places, "--sizes", sizes, "--out", tmp_path / "board.json")
    assert done.code == 0, done.err
    (k1,) = json.loads((tmp_path / "board.json").read_text())["components"]
    assert (k1["width"], k1["height"]) == (15.0, 7.5)
