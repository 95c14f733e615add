from __future__ import annotations

import gzip
import io
import tarfile
import zipfile
from pathlib import Path

import pytest

from tests.board_data.readers import samples
from tests.board_data.readers.test_unix_compress import compressed
from vaoi_station.board_data.design import Design, rotated
from vaoi_station.board_data.pin_rules import RULES, Rule
from vaoi_station.board_data.readers.odb import is_odb, read_odb
from vaoi_station.errors import InputError

TOP = "job/steps/pcb/layers/comp_+_top/components"
PROFILE, PACKAGES = "job/steps/pcb/profile", "job/steps/pcb/eda/data"


def write(folder: Path, **members: str) -> Path:
    path = folder / "b.zip"
    path.write_bytes(samples.odb_zip(samples.ODB | members))
    return path


def test_folder_tar_and_compressed_members(tmp_path: Path) -> None:
    expected = [(p.ref, p.origin) for p in read_odb(write(tmp_path)).parts]
    folder = tmp_path / "folder"
    for name, text in samples.ODB.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    assert is_odb(folder)
    assert [(p.ref, p.origin) for p in read_odb(folder).parts] == expected
    with tarfile.open(tmp_path / "b.tgz", "w:gz") as tar:
        for name, text in samples.ODB.items():
            packed = gzip.compress(text.encode()) if "components" in name else text.encode()
            info = tarfile.TarInfo(name + (".Z" if "components" in name else ""))
            info.size = len(packed)
            tar.addfile(info, io.BytesIO(packed))
    assert [(p.ref, p.origin) for p in read_odb(tmp_path / "b.tgz").parts] == expected
    with zipfile.ZipFile(tmp_path / "c.zip", "w") as zipped:
        for name, text in samples.ODB.items():
            zipped.writestr(f"{name}.Z", compressed(text.encode()))
    assert [(p.ref, p.origin) for p in read_odb(tmp_path / "c.zip").parts] == expected


def test_a_compressed_member_is_read_to_its_end_or_refused(tmp_path: Path) -> None:
    """A cut-off member would give a board with fewer parts."""
    lines = "".join(f"CMP 0 {n} {n * n % 97} 0 N R{n} x ;\n" for n in range(500))
    first, second = (gzip.compress(text.encode()) for text in ("UNITS=MM\n" + lines[:5000], lines[5000:]))
    path = tmp_path / "b.zip"

    def write_member(content: bytes) -> None:
        with zipfile.ZipFile(path, "w") as zipped:
            for name, text in (samples.ODB | {TOP: ""}).items():
                zipped.writestr(name, content if name == TOP else text)

    write_member(first + second)
    assert sum(part.side == "top" for part in read_odb(path).parts) == 500
    for kept in range(2, len(second), 97):
        write_member(first + second[:kept])
        with pytest.raises(InputError, match=r"components: is no valid gzip file: "):
            read_odb(path)


def test_courtyards_of_kicad_are_no_bodies_but_hulls_are(tmp_path: Path) -> None:
    """A hull touches the pins, as R's does here; the courtyard of J leaves 0.2 mm around them."""
    packages = samples.ODB[PACKAGES].replace("OE\nCE\n", "OE\nCE\nPIN 1 T 1 0 0 U U\nRC 0.2 -1.8 7.6 3.6\n")
    sizes = {}
    for program in ("KiCad EDA 9.0.2", "Another"):
        info = f"UNITS=MM\nSAVE_APP={program}\n"
        design = read_odb(write(tmp_path, **{PACKAGES: packages, "job/misc/info": info}))
        sizes[program] = {part.ref: part.box and part.box.size for part in design.parts}
    assert sizes["Another"]["J1"] == pytest.approx((8, 4))
    assert sizes["KiCad EDA 9.0.2"]["J1"] == pytest.approx((7.5, 3.5))
    assert sizes["KiCad EDA 9.0.2"]["R1"] == sizes["Another"]["R1"] == pytest.approx((2, 1.2))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        (TOP, "UNITS=MM\nCMP 0 1 1\n", "line 2: 'CMP 0 1 1' must be CMP package x y rotation mirror name part"),
        (TOP, "UNITS=MM\nCMP 0 a 1 0 N R1 x ;\n", "line 2: .* must have 4 numbers"),
        (TOP, "UNITS=MM\nCMP 0 nan 1 0 N R1 x ;\n", "line 2: .* must have 4 numbers"),
        (PROFILE, "UNITS=MM\nS P 0\nOB 0 0 I\nOC 0 40 nan 40 N\nOE\n", "line 4: 'OC 0 40 nan 40 N' must have 4"),
        (PACKAGES, "UNITS=MM\nPKG R 0 -2 -1 2 1;\nCR 0 0 nan\n", "line 3: 'CR 0 0 nan' must have 3 numbers"),
        (TOP, "UNITS=CUBIT\n", "UNITS is 'CUBIT', but must be MM or INCH"),
        (TOP, "\x1f\x9d\x90\x01\x03\x02\x01", r"components: is no valid file of compress \(\.Z\): names entry"),
    ],
)
def test_wrong_files_are_refused(name: str, text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "b.zip"
    content = samples.ODB | {name: text}
    with zipfile.ZipFile(path, "w") as zipped:
        for member, value in content.items():
            zipped.writestr(member, value.encode("latin-1") if member == name else value)
    with pytest.raises(InputError, match=message):
        read_odb(path)


def test_a_design_without_components_and_an_archive_that_is_none(tmp_path: Path) -> None:
    (tmp_path / "b.zip").write_bytes(samples.odb_zip({"job/matrix/matrix": "", "job/steps/pcb/profile": ""}))
    with pytest.raises(InputError, match=r"no step has components \(steps: pcb\)"):
        read_odb(tmp_path / "b.zip")
    (tmp_path / "c.zip").write_bytes(samples.odb_zip({"readme": ""}))
    assert not is_odb(tmp_path / "c.zip")
    with pytest.raises(InputError, match="has no file matrix/matrix"):
        read_odb(tmp_path / "c.zip")


PKG_SOT = "UNITS=MM\nPKG SOT 1 -1.5 -1.4 1.5 1.4;\nRC -1.5 -0.65 3 1.3\n" + "".join(
    f"PIN {name} S {x} {y} 0 U U\nRC {x - 0.3} {y - 0.3} 0.6 0.6\n"
    for name, x, y in (("A", -0.95, -1.1), ("B", 0.95, -1.1), ("C", 0.0, 1.1))
)
PKG_CONN = "PKG CONN 1 0 -2 8 2;\nRC 0 -2 8 4\nPIN 1 S 0 0 0 U U\nCR 0 0 0.3\nPIN 2 S 7 0 0 U U\nCR 7 0 0.3\n"
BOTTOM = "job/steps/pcb/layers/comp_+_bot/components"
SOT = ((-0.95, -1.1), (0.95, -1.1), (0.0, 1.1))
CONN = ((0.0, 0.0), (7.0, 0.0))


def toeprints(
    pins: tuple[tuple[float, float], ...], mirrored: bool, turn: float, first: int = 0, name: str = "t"
) -> str:
    """Return the toeprints of a part at (20, 10) that is turned counter-clockwise by an angle."""
    lines = ""
    for n, (x, y) in enumerate(pins, first):
        dx, dy = rotated((-x if mirrored else x, y), turn)
        lines += f"TOP {n} {20 + dx:.4f} {10 + dy:.4f} 0 N 0 0 {name}{n}\n"
    return lines


def read_side(folder: Path, layer: str, text: str, info: str = "UNITS=MM\n") -> Design:
    other = TOP if layer == BOTTOM else BOTTOM
    members = {PACKAGES: PKG_SOT + PKG_CONN, layer: "UNITS=MM\n" + text, other: "UNITS=MM\n", "job/misc/info": info}
    return read_odb(write(folder, **members))


@pytest.mark.parametrize("word", ["N", "M"])
@pytest.mark.parametrize("layer", [TOP, BOTTOM])
@pytest.mark.parametrize("rule", RULES)
def test_toeprints_show_how_parts_are_turned_and_mirrored(rule: Rule, layer: str, word: str, tmp_path: Path) -> None:
    text = ""
    for degrees in (0, 45, 90, 270):
        turn = rule.sign * degrees + rule.offset
        text += f"CMP 0 20 10 {degrees} {word} Q{degrees} x ;\n" + toeprints(SOT, rule.mirrored, turn)
        text += f"CMP 1 20 10 {degrees} {word} J{degrees} x ;\n" + toeprints(CONN, rule.mirrored, turn)
    design = read_side(tmp_path, layer, text)
    for part in design.parts:
        turn = rule.rotation(float(part.ref[1:]))
        assert part.rotation == turn, part.ref
        dx, dy = rotated((-4 if rule.mirrored else 4, 0), turn)
        assert part.center == pytest.approx((20 + dx, 10 + dy) if part.ref[0] == "J" else (20, 10), abs=1e-6)
    (note,) = design.notes
    assert (note.code, note.values["fit"], note.values["pins"]) == ("rotation-by-pins", "16", "16")


@pytest.mark.parametrize(
    ("info", "rotation", "center"),
    [("UNITS=MM\n", 90, (20, 6)), ("UNITS=MM\nSAVE_APP=KiCad EDA 9.0.2\n", 270, (20, 6))],
)
def test_without_toeprints_the_specification_or_kicads_rule_holds(
    info: str, rotation: float, center: tuple[float, float], tmp_path: Path
) -> None:
    design = read_side(tmp_path, BOTTOM, "CMP 1 20 10 90 M J1 x ;\n", info)
    (part,), (note,) = design.parts, design.notes
    assert (part.rotation, note.code) == (rotation, "rotation-unconfirmed")
    assert part.center == pytest.approx(center)


@pytest.mark.parametrize(
    ("pins", "says"),
    [
        (toeprints(SOT, True, 90, first=7), "pins-unfit"),
        (toeprints(SOT, True, 90, first=1), None),
        (toeprints(SOT[::-1], True, 90), "pins-unfit"),
        (toeprints(SOT, True, 45), "angles-by-pins"),
        ("TOP 0 nan 3 0 N 0 0 A\n", "toeprints-left-out"),
        ("TOP 0 3\n", "toeprints-left-out"),
        ("TOP x 3 4 0 N 0 0 A\n", "toeprints-left-out"),
        ("TOP -1 3 4 0 N 0 0 A\n", "toeprints-left-out"),
    ],
)
def test_wrong_toeprints_of_one_part_are_named_and_spoil_no_other(pins: str, says: str | None, tmp_path: Path) -> None:
    good = "".join(f"CMP 0 20 10 {a} N Q{a} x ;\n" + toeprints(SOT, True, a) for a in (0, 45, 90, 270))
    design = read_side(tmp_path, BOTTOM, good + "CMP 0 20 10 90 N U9 x ;\n" + pins)
    assert [p.rotation for p in design.parts] == [0, 45, 90, 270, 45 if says == "angles-by-pins" else 90]
    named = {note.code for note in design.notes if "U9" in note}
    assert named == ({says} if says else set())


def contour(x0: float, y0: float, x1: float, y1: float, kind: str) -> str:
    corners = ((x1, y0), (x1, y1), (x0, y1), (x0, y0))
    return f"OB {x0} {y0} {kind}\n" + "".join(f"OS {x} {y}\n" for x, y in corners) + "OE\n"


BOARD = contour(0, 0, 60, 50, "I")
HOLE, OTHER = contour(30, 30, 40, 40, "H"), contour(100, 0, 300, 100, "I")
FRAME = contour(-20, -20, 80, 70, "I") + contour(-5, -5, 65, 55, "H")


@pytest.mark.parametrize(
    ("profile", "cut_outs"),
    [
        (HOLE + BOARD, [(30, 30)]),
        (BOARD + HOLE, [(30, 30)]),
        (OTHER + HOLE + BOARD, [(100, 0), (30, 30)]),
        (BOARD + OTHER, [(100, 0)]),
        (FRAME + BOARD, [(-20, -20), (-5, -5)]),
    ],
    ids=["hole first", "hole behind", "larger island first", "larger island behind", "within a frame"],
)
def test_the_outline_is_the_island_with_most_parts_not_the_first_contour(
    profile: str, cut_outs: list[tuple[float, float]], tmp_path: Path
) -> None:
    parts = "UNITS=MM\nCMP 0 20 10 0 N R1 x ;\nCMP 0 20 20 0 N R2 x ;\nCMP 0 120 20 0 N R3 x ;\n"
    path = write(tmp_path, **{PROFILE: f"UNITS=MM\nS P 0\n{profile}SE\n", TOP: parts, BOTTOM: "UNITS=MM\n"})
    design = read_odb(path)
    assert set(design.outline) == {(0, 0), (60, 0), (60, 50), (0, 50)}
    assert [min(corners) for corners in design.cut_outs] == cut_outs
