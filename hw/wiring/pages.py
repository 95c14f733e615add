"""Write drawings, tables and lists from the circuit (`python -m hw.wiring`); a test checks that they are up to date."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from hw.wiring.circuit import OPEN, Circuit, Part, Sheet, read_circuit
from hw.wiring.drawing import svg
from hw.wiring.figure import Firmware, row
from hw.wiring.figures import all_figures

HW = Path(__file__).parents[1]
PAGE = HW / "wiring.md"
CONTROLLER = "A1"
_BLOCK = re.compile(r"(<!-- drawn: ([\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)
PORTS = {f"D{k}": f"P{'D' if k < 8 else 'B'}{k % 8}" for k in range(14)} | {f"A{k}": f"PC{k}" for k in range(6)}
"""Arduino's names of the chip's ports D, B and C."""


def made(circuit: Circuit) -> dict[Path, str]:
    """Return every generated file with its content. In hw/wiring.md only the generated blocks are replaced."""
    drawings = {HW / "wiring" / "drawings" / f"{sheet.name}.svg": svg(circuit, sheet) for sheet in circuit.sheets}
    lists = {HW / "bill-of-materials.csv": _csv(("reference", "pieces", "part"), materials(circuit))}
    nets = {HW / "wiring" / "nets.csv": _csv(("net", "pins"), ends(circuit))}
    return drawings | lists | nets | {PAGE: redrawn(PAGE.read_text(encoding="utf-8"), circuit)}


def redrawn(text: str, circuit: Circuit) -> str:
    """Return the text of a page with its generated blocks renewed.

    Raises:
        KeyError: the page has a block that no function generates.
    """
    blocks = {
        "pins": _table(("Nano", "ATmega328P", "net", "goes to"), controller_pins(circuit)),
        "materials": _table(("reference", "pieces", "part"), materials(circuit)),
    }
    for name, figures in all_figures(circuit, Firmware.read()).items():
        blocks[name] = _table(("figure", "formula", "value", "limit"), map(row, figures))
    return _BLOCK.sub(lambda found: found[1] + blocks[found[2]] + found[3], text)


def controller_pins(circuit: Circuit) -> list[tuple[str, str, str, str]]:
    """List the controller's pins: name on the board, name on the chip, net, and the pins connected to it."""
    rows = []
    for pin, net in circuit.part(CONTROLLER).pins:
        others = [f"{p.ref} {p.name}" for p in circuit.nets[net] if p.ref != CONTROLLER]
        rows.append((pin, PORTS.get(pin, ""), net, ", ".join(others[:3]) + (" …" if len(others) > 3 else "")))
    return rows


def materials(circuit: Circuit) -> list[tuple[str, int, str]]:
    """List the materials: references, number of pieces for the whole circuit, description."""
    rows = []
    for sheet in circuit.sheets:
        rows += [(_reference(sheet, part), part.count * sheet.built, part.what) for part in sheet.parts]
    return rows


def ends(circuit: Circuit) -> list[tuple[str, str]]:
    """List every net with all its pins, for a continuity test of the wiring."""
    return [(net, "; ".join(f"{p.ref} {p.name}" for p in pins)) for net, pins in circuit.nets.items() if net != OPEN]


def write() -> None:
    """Write all generated files again."""
    for path, content in made(read_circuit()).items():
        path.write_text(content, encoding="utf-8")


def _reference(sheet: Sheet, part: Part) -> str:
    return f"{part.ref} on each “{sheet.name}”" if sheet.copies else part.ref


def _table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(str(cell) for cell in line) + " |\n" for line in lines)


def _csv(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(rows)
    return file.getvalue()
