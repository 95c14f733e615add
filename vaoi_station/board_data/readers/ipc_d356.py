"""Read the points of an IPC-D-356 netlist that a probe can reach.

A record has fixed columns up to the pin; letters say what follows. Coordinates are as seen from the top, in
0.0001 inch (`CUST 0` and `2`) or 0.001 mm (`CUST 1`). The access is 0 for both sides, 1 for the top, otherwise a layer,
of which the highest is the bottom. `S` states the sides that solder mask covers: 1 top, 2 bottom, 3 both. Allegro
states the sides that it leaves open; then most surface pads seem to be covered on their own side.
Source: IPC-D-356A; the exporters of KiCad, pcb-rnd and Allegro.
"""

from __future__ import annotations

import re
from pathlib import Path

from vaoi_station.board_data.design import NetPoint, PointKind
from vaoi_station.board_data.net_points import numbered
from vaoi_station.board_data.source_text import decode
from vaoi_station.errors import InputError

_BEGIN = re.compile(rb"(C  [^\n]*\n)*P  (JOB|UNITS|CODE|TITLE)\b")
_MM_PER_STEP = {"0": 0.00254, "1": 0.001, "2": 0.00254}
_FEATURE = re.compile(r"A(\d\d)X([+-]?\d{1,7})Y([+-]?\d{1,7})(?:X(\d{1,4})(?:Y(\d{1,4}))?)?")
_MASK = re.compile(r"S([0-3])\s*$")
_PROBED = frozenset(("317", "327", "307"))
"""Through holes, surface pads, blind and buried vias; others are tooling holes, outlines, conductors."""


def is_ipc_d356(head: bytes) -> bool:
    """Return whether a file begins like an IPC-D-356 netlist."""
    return _BEGIN.match(head.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").lstrip(b" \t\n")) is not None


def read_ipc_d356(data: bytes, path: Path) -> tuple[NetPoint, ...]:
    """Read the points that are reachable on a side."""
    unit, names, found = "", dict[str, str](), list[tuple[NetPoint, int, int | None]]()
    for number, line in enumerate(decode(data, path).splitlines(), 1):
        words = line.split()
        if line.startswith("P") and words[1:2] == ["UNITS"]:
            unit = words[3] if len(words) > 3 else "0"
            if words[2:3] != ["CUST"] or unit not in _MM_PER_STEP:
                where, stated = f"{path}, line {number}", " ".join(words[2:])
                raise InputError.field(where, "UNITS", stated, "CUST 0, CUST 1 or CUST 2")
        elif line.startswith("P") and len(words) > 2 and words[1].startswith("NNAME"):
            names[words[1]] = words[2]
        elif line[:3] in _PROBED and (feature := _FEATURE.search(line, 31)) is not None:
            net, mask, mm = line[3:17].strip(), _MASK.search(line), _MM_PER_STEP[unit or "0"]
            ref, pin, at = line[20:26].strip(), line[27:31].strip(), (int(feature[2]) * mm, int(feature[3]) * mm)
            sizes = [int(size) * mm for size in feature.groups()[3:] if size and int(size)]
            kind: PointKind = "via" if ref == "VIA" else "pin" if line[:3] == "317" else "pad"
            # A point without part and pin is no via in all programs.
            own = "" if ref or pin else f"point {names.get(net, net)}"
            ref = "" if ref == "VIA" else ref
            point = NetPoint(ref, pin, names.get(net, net), at, False, False, kind, min(sizes, default=None), own)
            found.append((point, int(feature[1]), None if mask is None else int(mask[1])))
    bottom = max((access for _, access, _ in found), default=0)
    hidden = [
        sides & (1 if access == 1 else 2) for point, access, sides in found if point.kind == "pad" and sides is not None
    ]
    states_open = 2 * sum(map(bool, hidden)) > len(hidden)
    points = []
    for point, access, sides in found:
        covered = 0 if sides is None else 3 - sides if states_open else sides
        top, below = access in (0, 1) and not covered & 1, access in (0, bottom) and access != 1 and not covered & 2
        points.append(point._replace(on_top=top, on_bottom=below))
    out = numbered(points)
    if not out:
        raise InputError(f"{path}: has no point that a probe can reach.", action="Export the netlist with its pads.")
    return out
