"""Tests of `docs/internals/ring.md`: its table equals the layout, and its C program reads a ring."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np

from tests.needs import need
from vaoi_station.acquisition.ring import HEADER, INCOMPLETE, OK, FrameShape, Ring, RingLayout

DOCUMENT = (Path(__file__).parents[3] / "docs" / "internals" / "ring.md").read_text()
SIZES = {"char[8]": 8, "u32": 4, "u64": 8}


def test_the_header_table_is_the_layout() -> None:
    rows = re.findall(r"^\| (\d+) \| (\S+) \| (\w+) \|", DOCUMENT, re.MULTILINE)
    documented = {name: (int(offset), SIZES[kind]) for offset, kind, name in rows}
    assert HEADER.fields is not None
    assert documented == {name: (entry[1], entry[0].itemsize) for name, entry in HEADER.fields.items()}


def test_the_c_program_reads_what_the_station_wrote(tmp_path: Path) -> None:
    need("cc")
    (program,) = re.findall(r"```c\n(.*?)```", DOCUMENT, re.DOTALL)
    source, binary = tmp_path / "look.c", tmp_path / "look"
    source.write_text(program)
    subprocess.run(["cc", "-std=gnu11", "-Wall", "-Werror", "-o", str(binary), str(source)], check=True)
    layout = RingLayout(2, 2, (FrameShape(16, 16, "Mono8"), FrameShape(20, 30, "Mono16")), 4096)
    with Ring.create(tmp_path / "c.ring", layout) as ring:
        ring.claim(1)
        for slot, state, row, grey in ((ring.slot(1, 0, 1), OK, 5, 7), (ring.slot(1, 1, 0), INCOMPLETE, 2, 300)):
            ring.frame(slot)[:] = np.array(grey)
            ring.write_slot_record(slot, state, row, 1)
        done = subprocess.run([binary, ring.path, "1"], check=True, capture_output=True, text=True)
        assert done.stdout.splitlines() == ["camera 0 row 5 ok 7.000", "camera 1 row 2 incomplete 300.000"]
        assert subprocess.run([binary, ring.path, "2"], check=False).returncode == 2
