from __future__ import annotations

from dataclasses import replace

import pytest

from vaoi_station.board_data.design import Box, Design, Mark, Part
from vaoi_station.board_data.marks import find_marks, kind_by_name

OUTLINE = ((0.0, 0.0), (50.0, 0.0), (50.0, 40.0), (0.0, 40.0))
BODY = Box((-5.0, -5.0), (5.0, 5.0))


def part(ref: str, at: tuple[float, float], **change: object) -> Part:
    return replace(Part(ref, "top", at, 0.0), **change)  # type: ignore[arg-type]


def found(*parts: Part, marks: tuple[Mark, ...] = ()) -> dict[str, tuple[str, str, tuple[str, ...]]]:
    design = Design("d", "kicad", parts, OUTLINE, marks=marks)
    return {mark.name: (mark.kind, mark.found_by, mark.components) for mark in find_marks(design, "top")}


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("FID1", "global"),
        ("LFID2", "local"),
        ("Fiducial_Local_0.5mm", "local"),
        ("PANEL_FID", "panel"),
        ("BBM1", "bad-board"),
        ("Bad-Board-Mark_2mm", "bad-board"),
        ("X-OUT", "bad-board"),
    ],
)
def test_names_state_the_kind(text: str, kind: str) -> None:
    assert kind_by_name(text) == kind


def test_elements_come_first_and_names_add_only_other_kinds() -> None:
    parts = (part("FID9", (5, 5)), part("BBM1", (40, 5)), part("LFID1", (1, 1)), part("H1", (45, 35), is_mark=True))
    assert found(*parts, marks=(Mark("G1", "top", (1.05, 1.0)), Mark("B1", "bottom", (9, 9)))) == {
        "G1": ("global", "element", ()),
        "BBM1": ("bad-board", "name", ()),
    }


def test_a_pair_around_a_body_is_local_if_enough_others_are_global() -> None:
    body, others = part("U1", (25, 20), box=BODY), (part("FID1", (5, 5)), part("FID2", (45, 35)))
    pair = (part("FID3", (18, 27)), part("FID4", (32, 13)))
    kinds = found(body, *others, *pair)
    assert kinds["FID3"] == kinds["FID4"] == ("local", "place", ("U1",))
    assert kinds["FID1"][0] == "global"
    assert {kind for kind, _, _ in found(body, others[0], *pair).values()} == {"global"}
