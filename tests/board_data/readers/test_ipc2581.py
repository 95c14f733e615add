from __future__ import annotations

from pathlib import Path

import pytest

from tests.board_data.readers import samples
from vaoi_station.board_data.readers.ipc2581 import read_ipc2581
from vaoi_station.errors import InputError

PATH = Path("b.xml")


def read(*changes: tuple[str, str]) -> dict[str, tuple[float, tuple[float, float]]]:
    text = samples.IPC2581
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    design = read_ipc2581(text.encode(), PATH)
    return {p.ref: (p.rotation, p.center) for p in design.parts}


def test_the_pads_show_how_the_program_rotates_parts_of_the_bottom() -> None:
    assert read()["C1"][0] == 270
    # The same pad on the other side of the origin: mirrored first, then rotated.
    assert read(('<Location x="0.6405512" y="1.184252"/>', '<Location x="0.5405512" y="0.784252"/>'))["C1"][0] == 90


def test_kicads_rule_is_known() -> None:
    history = '<HistoryRecord><SoftwarePackage name="KiCad"/></HistoryRecord><Bom>'
    rotation, center = read(("<Bom>", history))["C1"]
    assert rotation == 90
    assert center == pytest.approx((15, 21), abs=1e-3)


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


def test_a_file_without_components_and_one_of_several_steps() -> None:
    bare = (
        samples.IPC2581[: samples.IPC2581.index("<Component")]
        + samples.IPC2581[samples.IPC2581.index("<LayerFeature") :]
    )
    with pytest.raises(InputError, match="no step has a component"):
        read_ipc2581(bare.encode(), PATH)
    component = '<Component refDes="Z" packageRef="Q" layerRef="TOP"><Location x="0" y="0"/></Component>'
    second = f'<Step name="other">{component}</Step>'
    design = read_ipc2581(samples.IPC2581.replace("</CadData>", second + "</CadData>").encode(), PATH)
    assert design.notes == ("the file has 2 steps with components (sample, other); sample was read. Choose by --step.",)


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
