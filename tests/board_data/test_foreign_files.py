from __future__ import annotations

import gzip
import io
import tarfile
import zipfile
from pathlib import Path

import pytest

from tests.board_data.readers import samples
from vaoi_station.board_data import is_exported_run, read_design
from vaoi_station.board_data.foreign_files import refuse_foreign
from vaoi_station.errors import InputError


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("b.kicad_pcb", b'(kicad_sch (version 20230121) (generator "eeschema"))', "is a schematic of KiCad"),
        ("b.kicad_pcb", b"EESchema Schematic File Version 4\n", "is a schematic of KiCad 5"),
        ("b.gbr", b"%TF.GenerationSoftware,KiCad*%\n%FSLAX46Y46*%\n%MOMM*%\n", "is a Gerber file, not board data"),
        ("b.gbr", b"G04 Layer: TopLayer*\nG04 EasyEDA*\n", "is a Gerber file"),
        ("b.drl", b"M48\n;DRILL file\nFMAT,2\n", "is a drill file"),
        ("b.xml", b"%PDF-1.7\n%\xe2\xe3", "is a PDF"),
        ("b.xml", b"\n<!DOCTYPE html><html><body>404</body></html>", "is a page without data"),
        ("b.xml", b'<?xml version="1.0"?>\n<project xmlns="x"/>', "is an XML file of another kind"),
        ("b.brd", b"\x10\x80\x45\x00\x00\x01", "is a binary file of EAGLE 5"),
        ("b.PcbDoc", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(500), "is a binary file of Altium or Excel"),
        ("b.rar", b"Rar!\x1a\x07\x01\x00", "is a RAR archive"),
        ("b.png", b"\x89PNG\r\n\x1a\n", "is a picture"),
        ("b.d356", b"C  from a CAD system\nP  JOB   b\nP  UNITS CUST 0\n", "is an IPC-D-356 netlist"),
        (
            "b.kicad_pcb",
            b"A fake board\nfor a test",
            "is no board of KiCad, as its name says; it begins with 'A fake b",
        ),
        ("b.brd", b"ref,x,y\nR1,1,2\n", "is no board of EAGLE, as its name says; it begins with 'ref,x,y'"),
        ("b.mnb", b"", "is empty"),
        ("b.kicad_pcb", b"\n \n", "is empty"),
        ("b.step", b"ISO-10303-21;\nHEADER;", "is a 3-D model"),
    ],
)
def test_files_of_other_kinds_are_named_and_what_to_give_instead(
    name: str, content: bytes, message: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message) as refused:
        read_design(tmp_path / name)
    assert refused.value.action


@pytest.mark.parametrize(
    "text",
    ["ref,x,y\n", "P1 1 2 90\n", "# a\n", "G04,1,2,90\nM48,1,2,90\n", "C 1 2 90\nP 1 2 90\n", "Ref\tX\tY\n", "", "\n"],
)
def test_tables_are_no_file_of_another_kind(text: str) -> None:
    refuse_foreign(Path("f"), text.encode())


def archive(path: Path, members: dict[str, str]) -> bytes:
    if path.suffix == ".zip":
        path.write_bytes(samples.odb_zip(members))
    else:
        with tarfile.open(path, "w:gz") as tar:
            for name, text in members.items():
                member = tarfile.TarInfo(name)
                member.size = len(text.encode())
                tar.addfile(member, io.BytesIO(text.encode()))
    return path.read_bytes()


@pytest.mark.parametrize("name", ["b.zip", "b.tgz"])
def test_archives_that_are_no_design_or_damaged_say_so(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    archive(path, {"gerber/top.gbr": "", "gerber/bottom.gbr": "", "a": "", "b": ""})
    with pytest.raises(InputError, match=r"without matrix/matrix, so no ODB\+\+ design; it holds gerber/.* and 1 more"):
        read_design(path)
    whole = archive(path, samples.ODB | {"job/symbols/a/features": "".join(map(str, range(5000)))})
    for kept in (len(whole) // 4, len(whole) // 2):
        path.write_bytes(whole[:kept])
        assert not is_exported_run(path)
        with pytest.raises(InputError, match="is no readable folder, zip or tar file") as refused:
            read_design(path)
        assert "\n" not in refused.value.message


def test_a_workbook_and_a_single_compressed_file_say_what_to_do(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "b.xlsx", "w") as book:
        book.writestr("xl/workbook.xml", "")
    with pytest.raises(InputError, match="is a workbook of Excel"):
        read_design(tmp_path / "b.xlsx")
    (tmp_path / "b.xml.gz").write_bytes(gzip.compress(samples.IPC2581.encode()))
    with pytest.raises(InputError, match="is no readable folder, zip or tar file") as refused:
        read_design(tmp_path / "b.xml.gz")
    assert "If it is one compressed file, unpack it" in refused.value.action
