"""One small board in every format is one design."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.board_data.readers import samples
from vaoi_station.board_data import read_design
from vaoi_station.board_data.contours import area
from vaoi_station.board_data.design import Design

FILES: dict[str, tuple[str, Callable[[], bytes]]] = {
    "kicad": ("b.kicad_pcb", samples.KICAD.encode),
    "gencad": ("b.cad", samples.GENCAD.encode),
    "ipc2581": ("b.xml", samples.IPC2581.encode),
    "odb": ("b.zip", samples.odb_zip),
    "eagle": ("b.brd", samples.EAGLE.encode),
    "html-bom": ("b.json", samples.HTML_BOM.encode),
}
CENTRES_OF_C1 = {"gencad": (15, 21), "ipc2581": (15, 29), "odb": (15, 21), "eagle": (15, 21)}
"""Where the body of C1 lies that the sample of a format describes: on the bottom, beside its origin."""


def design_of(kind: str, folder: Path) -> Design:
    name, content = FILES[kind]
    (folder / name).write_bytes(content())
    return read_design(folder / name)


@pytest.mark.parametrize("kind", FILES)
def test_places_rotations_and_bodies_agree(kind: str, tmp_path: Path) -> None:
    design = design_of(kind, tmp_path)
    assert design.format == kind
    parts = {part.ref: part for part in design.parts}
    assert parts.keys() - {"FID1"} == {"R1", "J1", "C1"}
    assert [parts[ref].side for ref in ("R1", "J1", "C1")] == ["top", "top", "bottom"]
    for ref, origin, center in (("R1", (10, 10), (10, 10)), ("J1", (30, 20), (30, 24)), ("C1", (15, 25), None)):
        assert parts[ref].origin == pytest.approx(origin, abs=1e-4)
        assert center is None or parts[ref].center == pytest.approx(center, abs=1e-4)
    assert (parts["R1"].rotation, parts["J1"].rotation) == (0, 90)
    body = parts["R1"].box
    assert body is not None
    assert body.size == pytest.approx((2, 1.2), abs=1e-4)
    if kind in CENTRES_OF_C1:
        assert parts["C1"].center == pytest.approx(CENTRES_OF_C1[kind], abs=1e-3)


@pytest.mark.parametrize("kind", FILES)
def test_outlines_with_arcs_and_cut_outs(kind: str, tmp_path: Path) -> None:
    design = design_of(kind, tmp_path)
    rectangle, half_circle, segment = 2000.0, 981.7, 168.7
    expected = {"kicad": rectangle + segment, "gencad": rectangle}.get(kind, rectangle + half_circle)
    assert abs(area(design.outline)) == pytest.approx(expected, rel=2e-3)
    holes = {"kicad": [28.3], "odb": [50.0]}.get(kind, [])
    assert [abs(area(c)) for c in design.cut_outs] == pytest.approx(holes, rel=0.02)


@pytest.mark.parametrize("kind", sorted(set(FILES) - {"html-bom"}))
def test_the_fiducial_has_the_diameter_of_its_copper(kind: str, tmp_path: Path) -> None:
    design = design_of(kind, tmp_path)
    found = [(mark.at, mark.diameter) for mark in design.marks]
    found += [(part.origin, part.mark_diameter) for part in design.parts if part.is_mark]
    assert len(found) == 1
    assert found[0][0] == pytest.approx((5, 5), abs=1e-4)
    assert found[0][1] == pytest.approx(1.2, abs=1e-4)


@pytest.mark.parametrize("kind", sorted(set(FILES) - {"gencad"}))
def test_parts_that_are_not_fitted_are_marked(kind: str, tmp_path: Path) -> None:
    assert [p.ref for p in design_of(kind, tmp_path).parts if not p.fitted] == ["C1"]


@pytest.mark.parametrize(
    ("kind", "ref", "height"), [("odb", "R1", 0.55), ("ipc2581", "R1", 0.508), ("gencad", "J1", 3)]
)
def test_body_heights_of_the_file(kind: str, ref: str, height: float, tmp_path: Path) -> None:
    part = next(p for p in design_of(kind, tmp_path).parts if p.ref == ref)
    assert part.body_height == pytest.approx(height, abs=1e-4)
