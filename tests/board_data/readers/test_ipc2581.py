from __future__ import annotations

from pathlib import Path

import pytest

from tests.board_data.readers import samples
from vaoi_station.board_data.readers.ipc2581 import read_ipc2581
from vaoi_station.errors import InputError

PATH = Path("b.xml")


def read(*changes: tuple[str, str]) -> None:
    text = samples.IPC2581
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    read_ipc2581(text.encode(), PATH)


PAD = '<Location x="0.6405512" y="1.184252"/>'
"""Where pin 1 of C1 lies, at (0.2, 0.05) of its package, seen from its origin at (0.0050, 0.2) inch."""
KICAD = '<HistoryRecord><SoftwarePackage name="KiCad"/></HistoryRecord><Bom>'


@pytest.mark.parametrize(
    ("x", "y", "rotation", "center", "rule"),
    [
        (0.05, 0.2, 270, (15, 29), "mirrored in x, then turned clockwise by the angle"),
        (-0.05, -0.2, 90, (15, 21), "mirrored in x, then turned counter-clockwise by the angle"),
        (-0.05, 0.2, 90, (15, 29), "turned counter-clockwise by the angle"),
        (0.05, -0.2, 270, (15, 21), "turned clockwise by the angle"),
    ],
)
@pytest.mark.parametrize("history", ["<Bom>", KICAD])
def test_the_pads_show_how_a_program_turns_and_mirrors_parts_of_the_bottom(
    x: float, y: float, rotation: float, center: tuple[float, float], rule: str, history: str
) -> None:
    """At one angle, 90°, the rules with 180° are the others; the simpler ones come first."""
    pad = f'<Location x="{0.5905512 + x:.7f}" y="{0.984252 + y:.7f}"/>'
    text = samples.IPC2581.replace(PAD, pad).replace("<Bom>", history)
    design = read_ipc2581(text.encode(), PATH)
    part = next(p for p in design.parts if p.ref == "C1")
    assert part.rotation == rotation
    assert part.center == pytest.approx(center, abs=1e-3)
    (note,) = [n for n in design.notes if n.code == "rotation-by-pins"]
    assert (note.values["side"], note.values["fit"], note.values["pins"], note.values["rivals"]) == ("bottom", *"111")
    assert history == KICAD or note.values["rule"] == rule


@pytest.mark.parametrize(("history", "rotation", "center"), [("<Bom>", 270, (15, 29)), (KICAD, 90, (15, 29))])
def test_without_pads_the_rule_of_the_standard_or_of_kicad_holds_and_a_note_says_so(
    history: str, rotation: float, center: tuple[float, float]
) -> None:
    text = samples.IPC2581.replace('<PinRef componentRef="C1" pin="1"/>', "").replace("<Bom>", history)
    design = read_ipc2581(text.encode(), PATH)
    part = next(p for p in design.parts if p.ref == "C1")
    assert part.rotation == rotation
    assert part.center == pytest.approx(center, abs=1e-3)
    assert [n.values["side"] for n in design.notes if n.code == "rotation-unconfirmed"] == ["top", "bottom"]


def test_pins_of_one_number_may_lie_at_any_of_its_pads() -> None:
    """A through-hole pin has a pad on every layer, a tab several pads of one number."""
    first = '<Pin number="1"><Location x="0.2" y="0.05"/>'
    tab = '<Pin number="1"><Location x="-0.2" y="0.05"/><StandardPrimitiveRef id="P1"/></Pin>'
    text = samples.IPC2581.replace(first, tab + first)
    pads = "".join(
        f'<Pad><Location x="{0.5905512 + 0.05:.7f}" y="{0.984252 + y:.7f}"/><PinRef componentRef="C1" pin="1"/></Pad>'
        for y in (-0.2, 0.2, 0.2)
    )
    design = read_ipc2581(
        text.replace('<LayerFeature layerRef="BOT"><Set>', f'<LayerFeature layerRef="BOT"><Set>{pads}').encode(), PATH
    )
    (note,) = [n for n in design.notes if n.code == "rotation-by-pins"]
    assert (note.values["fit"], note.values["pins"]) == ("2", "2")


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ('CadHeader units="INCH"', 'CadHeader units="FOOT"', "CadHeader units is 'FOOT', but must be MILLIMETER"),
        ("<Component ", "<Part ", "not valid XML"),
        ('y="0.3937008"', 'y="nan"', "Location y is 'nan', but must be a number"),
        ('refDes="R1"', 'refDes=""', "a Component has no refDes"),
        ("IPC-2581", "IPC-9999", "its first element is <IPC-9999>"),
    ],
)
def test_wrong_files_are_refused(before: str, after: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read((before, after))


def test_kinds_of_marks_and_the_component_of_a_local_fiducial() -> None:
    location = '<Location x="0.1" y="0.2"/>'
    more = (
        f'<Set><LocalFiducial>{location}<PinRef componentRef="J1" pin="1"/></LocalFiducial></Set>'
        f"<Set><BadBoardMark>{location}</BadBoardMark><GoodPanelMark>{location}</GoodPanelMark></Set>"
    )
    top = '<LayerFeature layerRef="TOP">'
    design = read_ipc2581(samples.IPC2581.replace(top, top + more).encode(), PATH)
    assert {mark.name: (mark.kind, mark.components) for mark in design.marks} == {
        "GlobalFiducial1": ("global", ()),
        "LocalFiducial1": ("local", ("J1",)),
        "GoodPanelMark1": ("panel", ()),
        "BadBoardMark1": ("bad-board", ()),
    }


def bom(name: str, populate: str, ref: str = "C1", step: str = "") -> str:
    header = f'<BomHeader><StepRef name="{step}"/></BomHeader>' if step else ""
    return f'<Bom name="{name}">{header}<BomItem><RefDes name="{ref}" populate="{populate}"/></BomItem></Bom>'


FULL, LITE = bom("BOM:full", "true"), bom("BOM:lite", "false")
BOM = '<Bom><BomItem><RefDes name="C1" populate="false"/></BomItem></Bom>'


@pytest.mark.parametrize(
    ("boms", "fitted", "read"),
    [
        (FULL + LITE, True, "full"),
        (LITE + FULL, False, "lite"),
        ('<Content><BomRef name="BOM:full"/><BomRef name="BOM:lite"/></Content>' + LITE + FULL, True, "full"),
        ('<Content><BomRef name="BOM:lite"/></Content>' + FULL + LITE, False, "lite"),
        (FULL + bom("of another step", "false", step="other"), True, None),
        (bom("of a panel", "false", step="panel"), False, None),
        (LITE + bom("of other parts", "true", ref="X9"), False, None),
        (bom("empty", "true", ref="") + LITE, False, None),
    ],
    ids=[
        "first",
        "first is lite",
        "by content",
        "only one in content",
        "of another step",
        "of a panel",
        "other parts",
        "no parts",
    ],
)
def test_of_several_bills_of_the_same_parts_one_is_read_and_named(boms: str, fitted: bool, read: str | None) -> None:
    assert BOM in samples.IPC2581
    design = read_ipc2581(samples.IPC2581.replace(BOM, boms).encode(), PATH)
    assert next(part.fitted for part in design.parts if part.ref == "C1") is fitted
    assert [note.values["bom"] for note in design.notes if note.code == "bom-read"] == ([read] if read else [])
