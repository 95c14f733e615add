"""Draw a sheet as SVG: boxes in columns, and wires in the gaps between the columns.

If all pins of a net lie at one gap, the net is drawn as a wire with one vertical part, called its track. Every other
net is drawn as a flag with the net's name at each of its pins. The tracks in a gap are ordered so that no two wires
cover one another.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from graphlib import TopologicalSorter
from html import escape

from hw.wiring.circuit import GROUNDS, OPEN, SUPPLIES, Circuit, Part, Sheet

PITCH, HEAD, GAP_BETWEEN, TRACK, LEAD = 22, 40, 26, 12, 12
LETTER, SMALL = 7.0, 6.9
TOP, MARGIN = 64, 16
_COLOURS = {"wire": "#1b4f86", "supply": "#a32020", "ground": "#333", "box": "#222", "barrier": "#b06000"}


@dataclass(frozen=True)
class End:
    """A pin in the drawing: the point where its line leaves the box, and whether the gap is to the right of it."""

    net: str
    y: float
    from_left: bool


@dataclass
class Gap:
    """A gap between two columns, or at the left or right border: the pins that face it, and its position."""

    ends: list[End] = field(default_factory=list)
    wires: list[str] = field(default_factory=list)
    """Nets that are drawn as wires, one track each, from left to right."""
    left: float = 0.0
    right: float = 0.0
    tracks_at: float = 0.0

    def flags(self, from_left: bool) -> list[End]:
        """Return the pins on one side of the gap that get a flag."""
        return [e for e in self.ends if e.from_left == from_left and e.net not in self.wires]

    def of(self, net: str) -> list[End]:
        """Return the pins of one net that face this gap."""
        return [e for e in self.ends if e.net == net]

    def width(self) -> float:
        """Return the width that the gap needs for the flags on both sides and for the tracks."""
        sides = [max((_flag_width(e.net) for e in self.flags(side)), default=0.0) for side in (True, False)]
        return sides[0] + sides[1] + (len(self.wires) + 1) * TRACK + 2 * LEAD


@dataclass(frozen=True)
class Box:
    """A part with its position in the drawing."""

    part: Part
    x: float
    y: float
    width: float
    height: float


@dataclass(frozen=True)
class Layout:
    """All boxes and gaps of a sheet with their positions. `svg` draws them; tests check them."""

    sheet: Sheet
    boxes: tuple[Box, ...]
    gaps: tuple[Gap, ...]
    width: float
    height: float


def lay_out(circuit: Circuit, sheet: Sheet) -> Layout:
    """Choose the positions of all boxes and wires of a sheet."""
    columns = [[p for p in sheet.parts if p.column == c] for c in range(1 + max(p.column for p in sheet.parts))]
    tops = {p.ref: y for column in columns for p, y in zip(column, _stack(column), strict=True)}
    gaps = _gaps(columns, tops, _elsewhere(circuit, sheet))
    x, boxes = float(MARGIN), []
    for column, gap in zip([*columns, []], gaps, strict=True):
        gap.left, gap.right = x, x + gap.width()
        gap.tracks_at = x + LEAD + max((_flag_width(e.net) for e in gap.flags(True)), default=0.0) + TRACK
        x = gap.right
        width = max((_box_width(p) for p in column), default=0.0)
        boxes += [Box(p, x, tops[p.ref], width, _box_height(p)) for p in column]
        x += width
    return Layout(sheet, tuple(boxes), tuple(gaps), x + MARGIN, max(b.y + b.height for b in boxes) + 2 * MARGIN)


def segments(layout: Layout) -> dict[str, list[tuple[float, float, float, float]]]:
    """List the straight lines (x1, y1, x2, y2) of every net that is drawn as a wire."""
    lines: dict[str, list[tuple[float, float, float, float]]] = {}
    for gap in layout.gaps:
        for k, net in enumerate(gap.wires):
            x, ends = gap.tracks_at + k * TRACK, gap.of(net)
            drawn = lines.setdefault(net, [])
            drawn += [(gap.left if e.from_left else gap.right, e.y, x, e.y) for e in ends]
            drawn.append((x, min(e.y for e in ends), x, max(e.y for e in ends)))
    return lines


def svg(circuit: Circuit, sheet: Sheet) -> str:
    """Draw a sheet."""
    layout = lay_out(circuit, sheet)
    copies = f" — {sheet.built} ×" if sheet.copies else ""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {layout.width:.0f} {layout.height:.0f}" '
        f'width="{layout.width:.0f}" height="{layout.height:.0f}" font-family="DejaVu Sans, sans-serif">',
        '<rect width="100%" height="100%" fill="#fff"/>',
        _text(MARGIN, 28, sheet.title + copies, "start", size=15, bold=True),
        *(line for gap in layout.gaps for line in _wires(gap)),
        *(line for gap in layout.gaps for line in _flags(gap)),
        *(line for box in layout.boxes for line in _box(box)),
        *(_barrier(layout) if sheet.barrier else []),
        "</svg>\n",
    ]
    return "\n".join(parts)


def _stack(column: list[Part]) -> list[float]:
    y, tops = float(TOP), []
    for part in column:
        tops.append(y)
        y += _box_height(part) + GAP_BETWEEN
    return tops


def _elsewhere(circuit: Circuit, sheet: Sheet) -> set[str]:
    """Return the nets of a sheet that lead to other sheets. They get a flag at each pin."""
    others = {net for net, pins in circuit.nets.items() if any(pin.sheet != sheet.name for pin in pins)}
    return others | SUPPLIES | GROUNDS | {sheet.port}


def _gaps(columns: list[list[Part]], tops: dict[str, float], named: set[str]) -> list[Gap]:
    gaps = [Gap() for _ in range(len(columns) + 1)]
    for c, column in enumerate(columns):
        for part in column:
            for pins, gap, from_left in ((part.left, gaps[c], False), (part.right, gaps[c + 1], True)):
                gap.ends += [End(net, _pin_y(tops[part.ref], k), from_left) for k, (_, net) in enumerate(pins)]
    everywhere = [e.net for gap in gaps for e in gap.ends]
    for gap in gaps:
        here = [e.net for e in gap.ends]
        own = {n for n in here if here.count(n) == everywhere.count(n) > 1} - named
        gap.wires = _in_order(gap, sorted(own))
    return gaps


def _in_order(gap: Gap, nets: list[str]) -> list[str]:
    """Order the tracks of a gap from left to right, so that no two wires cover one another.

    If two wires have a pin at the same height, the track of the wire from the left comes first.
    """
    before: dict[str, list[str]] = {net: [] for net in nets}
    for left in nets:
        for right in nets:
            crossing = {e.y for e in gap.of(left) if e.from_left} & {e.y for e in gap.of(right) if not e.from_left}
            if left != right and crossing:
                before[right].append(left)
    return list(TopologicalSorter(before).static_order())


def _pin_y(top: float, k: int) -> float:
    return top + HEAD + k * PITCH


def _box_height(part: Part) -> float:
    return HEAD + max(len(part.left), len(part.right), 1) * PITCH - 8.0


def _box_width(part: Part) -> float:
    inside = [max((len(n) for n, _ in pins), default=0) for pins in (part.left, part.right)]
    return max(sum(inside) * SMALL + 34, *(len(line) * LETTER + 16 for line in _heading(part)))


def _heading(part: Part) -> tuple[str, str]:
    short = part.what.split(":")[0].split(",")[0].split(" (")[0]
    for word in ("resistor ", "capacitor "):
        if short.startswith(word):
            short = " ".join(short.split()[1:3])
    named = part.what.partition("(")[2].partition(")")[0].split(" or ")[0].split(",")[0]
    plain = named if named and part.ref[0] == "U" else short
    return (f"{part.ref} ({part.count} ×)" if part.count > 1 else part.ref), plain


def _flag_width(net: str) -> float:
    return 0.0 if net == OPEN else len(net) * SMALL + 26


def _text(
    x: float, y: float, words: str, anchor: str, *, size: int = 11, bold: bool = False, fill: str = "#222"
) -> str:
    weight = ' font-weight="bold"' if bold else ""
    place = f'x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"'
    return f'<text {place} font-size="{size}"{weight} fill="{fill}">{escape(words)}</text>'


def _line(x1: float, y1: float, x2: float, y2: float, colour: str) -> str:
    return f'<path d="M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}" stroke="{colour}" stroke-width="1.4" fill="none"/>'


def _wires(gap: Gap) -> list[str]:
    drawn = []
    for k, net in enumerate(gap.wires):
        x, ends = gap.tracks_at + k * TRACK, gap.of(net)
        low, high = min(e.y for e in ends), max(e.y for e in ends)
        drawn += [_line(gap.left if e.from_left else gap.right, e.y, x, e.y, _COLOURS["wire"]) for e in ends]
        if high > low:
            drawn.append(_line(x, low, x, high, _COLOURS["wire"]))
        meeting = {e.y for e in ends if sum(o.y == e.y for o in ends) + (low < e.y) + (e.y < high) > 2}
        drawn += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{_COLOURS["wire"]}"/>' for y in sorted(meeting)]
    return drawn


def _flags(gap: Gap) -> list[str]:
    drawn = []
    for from_left in (True, False):
        for end in gap.flags(from_left):
            if end.net == OPEN:
                continue
            kind = "supply" if end.net in SUPPLIES else "ground" if end.net in GROUNDS else "wire"
            start, sign = (gap.left, 1) if from_left else (gap.right, -1)
            far = start + sign * LEAD
            drawn.append(_line(start, end.y, far, end.y, _COLOURS[kind]))
            tip, back = far + sign * 6, far + sign * (len(end.net) * SMALL + 12)
            shape = f"M{far:.1f} {end.y:.1f}L{tip:.1f} {end.y - 8:.1f}H{back:.1f}V{end.y + 8:.1f}H{tip:.1f}Z"
            drawn.append(f'<path d="{shape}" fill="#f6f8fb" stroke="{_COLOURS[kind]}"/>')
            place = far + sign * 8
            drawn.append(
                _text(place, end.y + 4, end.net, "start" if from_left else "end", size=10, fill=_COLOURS[kind])
            )
    return drawn


def _box(box: Box) -> list[str]:
    title, value = _heading(box.part)
    middle = box.x + box.width / 2
    drawn = [
        f'<rect x="{box.x:.1f}" y="{box.y:.1f}" width="{box.width:.1f}" height="{box.height:.1f}" rx="3" '
        f'fill="#fffdf5" stroke="{_COLOURS["box"]}" stroke-width="1.3"/>',
        _text(middle, box.y + 13, title, "middle", bold=True),
        _text(middle, box.y + 26, value, "middle"),
    ]
    for pins, x, anchor in ((box.part.left, box.x + 5, "start"), (box.part.right, box.x + box.width - 5, "end")):
        drawn += [_text(x, _pin_y(box.y, k) + 4, name, anchor, size=10) for k, (name, _) in enumerate(pins)]
    return drawn


def _barrier(layout: Layout) -> list[str]:
    box = next(b for b in layout.boxes if b.part.ref == layout.sheet.barrier)
    x, top, bottom = box.x + box.width / 2, box.y - 14, box.y + box.height + 14
    colour = _COLOURS["barrier"]
    halves = f"M{x:.1f} {top:.1f}V{box.y:.1f}M{x:.1f} {box.y + 32:.1f}V{bottom:.1f}"
    return [
        f'<path d="{halves}" stroke="{colour}" stroke-width="2" stroke-dasharray="7 5"/>',
        _text(x + 6, bottom, "isolation", "start", size=10, fill=colour),
    ]
