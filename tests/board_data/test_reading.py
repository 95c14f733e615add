from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from tests.board_data.readers import samples
from tests.needs import FILMS, need_films
from vaoi_station.board_data import Options, read_design, to_board_type
from vaoi_station.board_data.design import Design, Part, Side
from vaoi_station.board_data.readers.placement_table import TableOptions
from vaoi_station.errors import InputError

BOARDS = FILMS / "boards"
KINDS = ("cad", "ipc2581.xml", "odb.zip", "pos", "pos.csv")


@pytest.fixture(scope="module")
def boards() -> Path:
    need_films()
    return BOARDS


@cache
def read(path: Path) -> Design:
    return read_design(path)


def placed(path: Path, side: Side) -> dict[str, Part]:
    design = read(path)
    board, _ = to_board_type(design, side)
    kept = {c.ref for c in board.components}
    return {p.ref: p for p in design.parts if p.side == side and p.ref in kept}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (Options(table=TableOptions(unit="inch")), "--units is 'inch', but must be absent: it is for centroid files"),
        (Options(table=TableOptions.parse(None, "x=1,y=2", None)), "--columns is 'x=1,y=2', but must be absent"),
        (Options(table=TableOptions(delimiter=";")), "--delimiter is ';', but must be absent"),
        (Options(step="panel"), r"--step is 'panel', but must be absent: it is for ODB\+\+ and IPC-2581, not kicad"),
    ],
)
def test_options_that_files_of_this_format_do_not_take_are_refused(
    tmp_path: Path, given: Options, message: str
) -> None:
    file = tmp_path / "b.kicad_pcb"
    file.write_text(samples.KICAD)
    with pytest.raises(InputError, match=message):
        read_design(file, given)


@pytest.mark.cases
@pytest.mark.parametrize("board", ["orangecrab", "esp32poe"])
@pytest.mark.parametrize("kind", KINDS)
def test_exports_of_a_real_board_agree_with_its_file(boards: Path, board: str, kind: str) -> None:
    real = boards / board / f"{board}.kicad_pcb"
    for side in ("top", "bottom"):
        expected, found = (placed(path, side) for path in (real, boards / board / f"{board}.{kind}"))
        assert expected.keys() <= found.keys()
        shift = [
            sorted(found[ref].origin[axis] - part.origin[axis] for ref, part in expected.items())[len(expected) // 2]
            for axis in (0, 1)
        ]
        for ref, part in expected.items():
            x, y = (found[ref].origin[axis] - shift[axis] for axis in (0, 1))
            assert math.dist((x, y), part.origin) <= 0.0101, ref
            assert abs((found[ref].rotation - part.rotation + 180) % 360 - 180) < 0.02, ref


@pytest.mark.cases
def test_production_data_of_a_real_board(boards: Path) -> None:
    odb = {p.ref: p for p in read_design(boards / "breakout" / "odbjob.tgz").parts}
    origins, bodies = (
        {p.ref: p for p in read_design(boards / "breakout" / f"{name}.txt").parts}
        for name in ("SYMBOL_ORIGIN", "BODY_CENTER")
    )
    assert odb.keys() == origins.keys() == bodies.keys()
    assert max(math.dist(part.origin, origins[ref].origin) for ref, part in odb.items()) < 0.001
    assert all((part.rotation, part.side) == (origins[ref].rotation, origins[ref].side) for ref, part in odb.items())
    # Four reported centres of R0402 and C0402 differ by 0.05 to 0.08 mm from the package, which is symmetrical.
    off = {ref for ref, part in odb.items() if math.dist(part.center, bodies[ref].origin) > 0.0101}
    assert off == {"R17", "C20", "C2132", "C2133"}
    assert sum(part.body_height is not None for part in odb.values()) == 57


@pytest.mark.parametrize(
    ("name", "text", "old", "new", "message"),
    [
        ("b.kicad_pcb", samples.KICAD, "(at 30 -20 90)", "(at 30 -20 inf)", r"\(at 30 -20 inf\): 'inf' is no number"),
        ("b.kicad_pcb", samples.KICAD, "(mid 25 -45)", "(mid nan -45)", r"\(mid nan -45\): 'nan' is no number"),
        ("b.kicad_pcb", samples.KICAD, "(mid 25 -45)", "(mid 1e200 -45)", r"\(mid 1e200 -45\): '1e200' is no number"),
        ("b.cad", samples.GENCAD, "LINE 0 0 1968.504 0", "ARC 0 0 nan 1 2 2", "line 7: 'ARC 0 0 nan 1 2 2' must"),
        ("b.cad", samples.GENCAD, "ROTATION 90", "ROTATION inf", "'ROTATION inf' must have 1 numbers"),
        ("b.cad", samples.GENCAD, "UNITS USER 1000", "UNITS USER ²", "UNITS is 'USER ²', but must be"),
        ("b.xml", samples.IPC2581, 'centerX="0.98425"', 'centerX="1e308"', "PolyStepCurve centerX is '1e308'"),
        ("b.brd", samples.EAGLE, 'curve="180"', 'curve="1e308"', "curve is '1e308', but must be a number"),
    ],
)
def test_a_value_that_is_no_length_and_no_angle_is_named(
    name: str, text: str, old: str, new: str, message: str, tmp_path: Path
) -> None:
    assert old in text
    (tmp_path / name).write_text(text.replace(old, new))
    with pytest.raises(InputError, match=message):
        read_design(tmp_path / name)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be", "utf-8-sig"])
@pytest.mark.parametrize("text", [samples.KICAD, samples.GENCAD, samples.IPC2581, samples.EAGLE, samples.HTML_BOM])
def test_every_format_is_recognised_in_every_encoding(text: str, encoding: str, tmp_path: Path) -> None:
    (tmp_path / "plain").write_text(text)
    (tmp_path / "encoded").write_bytes(text.encode(encoding))
    plain, encoded = (read_design(tmp_path / name) for name in ("plain", "encoded"))
    assert (encoded.format, encoded.parts, encoded.outline) == (plain.format, plain.parts, plain.outline)


def test_a_board_type_of_every_sample_can_be_stored(tmp_path: Path) -> None:
    content: dict[str, Any] = {"b.kicad_pcb": samples.KICAD, "b.cad": samples.GENCAD, "b.json": samples.HTML_BOM}
    for name, text in content.items():
        (tmp_path / name).write_text(text)
        board, _ = to_board_type(read_design(tmp_path / name), "top")
        assert json.loads(board.model_dump_json())["name"]
