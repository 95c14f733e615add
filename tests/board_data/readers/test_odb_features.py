from __future__ import annotations

from pathlib import Path

from tests.board_data.readers import samples
from vaoi_station.board_data import read_design, to_board_type
from vaoi_station.board_data.design import Mark
from vaoi_station.board_data.readers.odb_files import pad_marks

MATRIX = """STEP {
 NAME=PCB
}
LAYER {
 ROW=2
 TYPE=SIGNAL
 NAME=TOP
}
LAYER {
 ROW=1
 TYPE=SOLDER_MASK
 NAME=SMT
}
LAYER {
 ROW=5
 TYPE=SIGNAL
 NAME=BOT
}
LAYER {
 ROW=4
 TYPE=POWER_GROUND
 NAME=GND
}
"""
FEATURES = """UNITS=MM
$0 r1000
$1 s40 I
@0 .smd
@1 .pad_usage
@2 .fiducial_name
&0 BADBOARD_1
P 5 5 0 P 0 0;1=2;ID=7
P 45 35 1 P 0 0;0,1=3
P 20 1 0 P 0 0;2=0
P 1 1 0 P 0 0;0,1=1
P 2 nonsense 0 P 0 0;1=2
P 3 3 0 P 0 0
"""


def test_pads_with_a_usage_or_a_name_are_marks() -> None:
    assert list(pad_marks(FEATURES.splitlines(), 1.0, "top")) == [
        Mark("global1", "top", (5, 5), 1.0, "global", "attribute"),
        Mark("local2", "top", (45, 35), 1.016, "local", "attribute"),
        Mark("BADBOARD_1", "top", (20, 1), 1.0, "bad-board", "attribute"),
    ]


def test_a_design_has_the_marks_of_its_copper(tmp_path: Path) -> None:
    file = tmp_path / "b.zip"
    layers = {"job/matrix/matrix": MATRIX, "job/steps/pcb/layers/top/features": FEATURES}
    file.write_bytes(samples.odb_zip(samples.ODB | layers))
    board, _ = to_board_type(read_design(file), "top")
    assert [(f.name, f.kind) for f in board.fiducials] == [("global1", "global"), ("local2", "local")]
    assert [(m.name, m.kind) for m in board.other_marks or ()] == [("BADBOARD_1", "bad-board")]
    assert [len(c) for c in board.cut_outs or ()] == [3]
