"""Recognise which column of a centroid file holds what: by the words of the header, and by the values below it."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from vaoi_station.board_data.design import Side
from vaoi_station.board_data.readers.table_header import Table
from vaoi_station.board_data.readers.table_words import (
    MIRRORED,
    STATED_REF,
    UNIT_HEADERS,
    UPRIGHT,
    angle_in,
    designator_score,
    is_header,
    may_be_sides,
    may_mark_mirrored,
    may_state_fitted,
    named_columns,
    number_in,
    numbers_in,
    plain_key,
    sides_of,
)
from vaoi_station.errors import InputError

COLUMNS = ("ref", "x", "y", "rotation", "side", "package", "value", "fitted")
REQUIRED = ("ref", "x", "y")
NOT_THERE = "none"
"""What the user states as the column of a rotation that the file does not have."""
_WEAK_ROTATION = frozenset(("r", "phi", "direction", "drehrichtung", "orient", "ausrichtung"))
"""Headers that are those of a rotation only if the values are angles."""
_BARE_REF = re.compile(r"^[A-Za-z*_][\w*.\-/+$]*$")
_LEAST_DESIGNATORS = 0.3
"""Score of a column of designators; below it values do not decide."""
_CLEARLY_DESIGNATORS = 0.8
_SAME_SCORE = 0.1
_LIKELY_ANGLES = 0.5
"""Share of angles that are multiples of 15° in a column of rotations."""
_Rows = Sequence[Sequence[str]]


@dataclass(frozen=True)
class TableLayout:
    """What the columns of a table hold."""

    columns: Mapping[str, int]
    headers: tuple[str, ...]
    all_on: Side | None
    """The side of all parts, as the user states it."""
    without_rotation: bool
    """Whether the user states that there is no rotation."""
    unused: tuple[str, ...]
    """Headers of the columns that are not used; of a table without header their numbers."""
    sides: Mapping[str, Side]
    """The side that each value of its column states."""
    unit: int | None
    """The column of the unit of each line."""
    mirror: int | None
    """A column beside that of the side which says which parts are mirrored."""

    def header_of(self, name: str) -> str:
        """Return the header of a column; empty without one."""
        at = self.columns.get(name, len(self.headers))
        return self.headers[at] if at < len(self.headers) else ""

    def cell(self, cells: Sequence[str], name: str) -> str:
        """Return the cell of a column; empty without one."""
        at = self.columns.get(name, len(cells))
        return cells[at] if at < len(cells) else ""

    @property
    def last(self) -> int:
        """Index of the last column that every part must have."""
        return max(self.columns[name] for name in REQUIRED)


def layout_of(table: Table, path: Path, stated: Sequence[tuple[str, str]]) -> TableLayout:
    """Return what the columns hold; refuse a header that leaves open where place, rotation or side stand.

    Args:
        table: the table.
        path: the file, for messages.
        stated: pairs of a name of `COLUMNS` and the header or the number of its column, as the user states them.

    Raises:
        InputError: a column is not recognised, or does not exist.
    """
    rows, headers, has_header = table.rows, table.headers, table.header is not None
    widths = map(len, rows) if rows else (len(record.cells) for record in table.records)
    most = max([len(headers), *widths])
    given, all_on, without_rotation = _given_columns(path, stated, headers, most)
    found = columns_by_header(headers, rows) if has_header else {}
    if not has_header and not all(name in given for name in REQUIRED):
        found = columns_without_header(rows) or {}
    columns = dict(given)
    for name, at in found.items():
        hidden = (name == "side" and all_on is not None) or (name == "rotation" and without_rotation)
        if not hidden and name not in columns and at not in given.values():
            columns[name] = at
    if missing := [name for name in REQUIRED if name not in columns]:
        raise _not_recognised(path, table, missing)
    if len({columns[name] for name in REQUIRED}) < len(REQUIRED):
        written = ",".join(f"{name}={columns[name] + 1}" for name in REQUIRED)
        raise InputError.field(path, "--columns", written, "three different columns for ref, x and y")
    columns = {name: columns[name] for name in COLUMNS if name in columns}
    unused = [n for n in range(most) if n not in columns.values()]
    side = columns.get("side", len(headers))
    values = _values(rows, side) if "side" in columns else []
    of_side = headers[side] if side < len(headers) else ""
    keys = [plain_key(header) for header in headers]
    mirror = (n for n, key in enumerate(keys) if key in MIRRORED and n != side and "side" in columns)
    layout = TableLayout(
        columns=columns,
        headers=headers,
        all_on=all_on,
        without_rotation=without_rotation,
        unused=tuple(headers[n] if n < len(headers) and headers[n] else str(n + 1) for n in unused),
        sides=sides_of([*values, ""], of_side if headers else "mirror" if "m" in values else ""),
        unit=next((n for n, key in enumerate(keys) if key in UNIT_HEADERS), None),
        mirror=next(mirror, None),
    )
    if has_header or given:
        _refuse_doubtful(path, layout, rows)
    of_required = {name: layout.header_of(name) for name in REQUIRED}
    twice = [name for name, header in of_required.items() if header and headers.count(header) > 1]
    if twice and not all(name in given for name in REQUIRED):
        raise InputError(
            f"{path}: its header names the columns of {' and '.join(twice)} twice, as of tables side by side.",
            action="Import each table from a file of its own, or name its columns by --columns ref=N,x=N,y=N.",
        )
    return layout


def _given_columns(
    path: Path, given: Sequence[tuple[str, str]], headers: Sequence[str], most: int
) -> tuple[dict[str, int], Side | None, bool]:
    """Return the columns that the user names, the side of all parts, and whether there is no rotation."""
    columns: dict[str, int] = {}
    all_on: Side | None = None
    without_rotation = False
    keys = [plain_key(cell) for cell in headers]
    for name, at in given:
        if name == "side" and at.lower() in ("top", "bottom"):
            all_on = "top" if at.lower() == "top" else "bottom"
        elif name == "rotation" and at.lower() == NOT_THERE:
            without_rotation = True
        elif re.fullmatch(r"[0-9]{1,6}", at) and 1 <= int(at) <= most:
            columns[name] = int(at) - 1
        else:
            same = [n for n, header in enumerate(headers) if header.strip().lower() == at.strip().lower()]
            same += [n for n, key in enumerate(keys) if key and key == plain_key(at)]
            if not same:
                limit = f"a number from 1 to {most}, or a header of {list(headers)}"
                raise InputError.field(path, f"--columns {name}", at, limit)
            columns[name] = same[0]
    return columns, all_on, without_rotation


def _not_recognised(path: Path, table: Table, missing: Sequence[str]) -> InputError:
    entries = ",".join(f"{name}=N" for name in missing)
    if table.header is not None:
        line = table.records[table.header].line
        return InputError(
            f"{path}, line {line}: the header {list(table.headers)} has no column that is recognised as "
            f"{', '.join(missing)}.",
            action=f"Name the columns by their numbers from 1 or their headers: --columns {entries}.",
        )
    return InputError(
        f"{path}: has no header with columns {', '.join(REQUIRED)}, and its lines are not designator, x, y, rotation.",
        action="Name the columns by --columns, for example --columns ref=1,x=3,y=4,rotation=5.",
    )


def _refuse_doubtful(path: Path, layout: TableLayout, rows: _Rows) -> None:
    """Refuse unused columns that may hold the rotation or the side, where the header does not show which does.

    A column that is not understood may be anything that its values allow: it must not be taken as absent.
    """
    headers, width = layout.headers, max((len(row) for row in rows), default=0)
    free = {n: plain_key(headers[n]) if n < len(headers) else "" for n in range(width)}
    free = {n: key for n, key in free.items() if n not in layout.columns.values()}
    foreign = {n for n, key in free.items() if not is_header(key, but=("side", "rotation"))}
    found: dict[str, list[int]] = {}
    if "rotation" not in layout.columns and not layout.without_rotation:
        found["rotation"] = [n for n in free if n in foreign and _may_be_angles(_values(rows, n))]
    if "side" not in layout.columns and layout.all_on is None:
        found["side"] = [n for n in free if may_be_sides(_values(rows, n), n in foreign)]
    for role, columns in found.items():
        if columns:
            shown = ", ".join(repr(headers[n]) if n < len(headers) else str(n + 1) for n in columns)
            other = "side=top, or side=bottom, for all parts" if role == "side" else f"rotation={NOT_THERE}"
            raise InputError(
                f"{path}: no column is recognised as the {role}, but it may be {shown}.",
                action=f"State it by --columns {role}={columns[0] + 1}; if it is not the {role}, by --columns {other}.",
            )


def _values(rows: _Rows, column: int) -> list[str]:
    return [row[column] for row in rows if column < len(row)]


# Columns by the header.


def columns_by_header(header: Sequence[str], rows: _Rows) -> dict[str, int]:
    """Return role → column, by the words of the header; the designators are chosen by their values."""
    named = named_columns(header)
    found: dict[str, int] = {}
    pairs = [(x, y) for x in named.get("x", ()) for y in named.get("y", ())]
    # A pair may be empty where another one is filled.
    pairs = [p for p in pairs if any(number_in(v) is not None for n in p for v in _values(rows, n))] or pairs
    if pairs:
        # Both axes are of one kind: no "Mid X" beside "Ref Y".
        kinds = [re.sub(r"[xy]", "", plain_key(cell)) for cell in header]
        found["x"], found["y"] = min(pairs, key=lambda p: (kinds[p[0]] != kinds[p[1]], named["x"].index(p[0])))
    if (ref := _designators(header, rows, set(found.values()))) is not None:
        found["ref"] = ref
    for role in ("side", "rotation", "fitted", "package", "value"):
        free = (n for n in named.get(role, ()) if n not in found.values())
        column = next((n for n in free if _fits(role, plain_key(header[n]), _values(rows, n))), None)
        if column is not None:
            found[role] = column
    return found


def _fits(role: str, key: str, values: Sequence[str]) -> bool:
    """Return whether the values of a column can be of the role that its header names.

    Words such as `Layer`, `Place`, `Type` and `Direction` are used for other things as well.
    """
    present = [value for value in values if value]
    if role == "rotation" and present and key in _WEAK_ROTATION:
        return sum(angle_in(value) is not None for value in present) * 2 > len(present)
    if role == "fitted" and present:
        return may_state_fitted(present)
    return role != "side" or key not in UPRIGHT | MIRRORED or may_mark_mirrored(present)


def _designators(header: Sequence[str], rows: _Rows, taken: set[int]) -> int | None:
    """Return the column of the designators: the one that is named so, else the one whose values look most like it."""
    keys = [plain_key(cell) for cell in header]
    named = [n for n in named_columns(header).get("ref", ()) if n not in taken]
    stated = [n for n in named if keys[n] in STATED_REF]
    # Row numbers are no designators where another column has some.
    values = {n: _values(rows, n) for n in range(len(keys))}
    several = [n for n in stated if len(set(values[n])) * 2 > len(values[n]) > numbers_in(values[n])]
    if several or (stated and len(named) == len(stated)):
        return (several or stated)[0]
    free = [n for n, key in enumerate(keys) if n not in taken and not is_header(key, but=("ref",))]
    scores = {n: _score(values[n]) for n in (named or free)}
    best = max(scores, key=lambda n: scores[n], default=None)
    if best is None or not named:
        return best if best is not None and scores[best] >= _CLEARLY_DESIGNATORS else None
    if scores[best] < _LEAST_DESIGNATORS:
        return named[0]
    return next(n for n in named if scores[n] >= scores[best] - _SAME_SCORE)


def _score(values: Sequence[str]) -> float:
    """Return from 0 to 1 how much values look like designators, different ones.

    On panels every designator occurs once a board, but values and packages occur more often.
    """
    if not values:
        return 0.0
    return sum(map(designator_score, values)) / len(values) * math.sqrt(len(set(values)) / len(values))


def rival_designators(layout: TableLayout, rows: _Rows) -> list[str]:
    """Return the headers of other columns that may hold the designators as well."""
    headers, chosen = layout.headers, layout.columns["ref"]
    if chosen >= len(headers) or plain_key(headers[chosen]) in STATED_REF:
        return []
    named = [n for n in named_columns(headers).get("ref", ()) if n != chosen]
    return [headers[n] for n in named if _score(_values(rows, n)) >= _LEAST_DESIGNATORS]


# Columns without a header.


def columns_without_header(rows: _Rows) -> dict[str, int] | None:
    """Return the columns of a table without a header: designator, x, y, rotation, then side, value and package.

    Returns None if the lines are of another kind, or if x or y looks more like a rotation than the fourth column.
    """
    usual = [r for r in rows if len(r) >= 4 and _BARE_REF.match(r[0]) and numbers_in(r[1:4]) == 3]
    if not usual or 2 * len(usual) < sum(len(row) > 1 for row in rows):
        return None
    shares = [_angle_share(_values(usual, n)) for n in (1, 2, 3)]
    angles = [angle for value in _values(usual, 3) if (angle := angle_in(value)) is not None]
    if max(map(abs, angles)) > 360 or shares[2] < min(max(shares[:2]), _LIKELY_ANGLES):
        return None
    found = {"ref": 0, "x": 1, "y": 2, "rotation": 3}
    width = Counter(map(len, usual)).most_common(1)[0][0]
    rest = list(range(4, width))
    # z or the number of a side may stand before the rotation, and a package such as 0402 before x.
    if any(_may_be_angles(_values(usual, n)) for n in rest):
        return None
    if any(re.fullmatch(r"0\d{3}", value) for value in _values(usual, 1)):
        return None
    if any(len(row) != width for row in usual) and any(row[4:5] in (["m"], ("m",)) for row in usual):
        return found | {"package": 4}  # Allegro: "m" is an additional cell
    values = {n: _values(usual, n) for n in rest}
    side = next((n for n in rest if may_be_sides(values[n], is_foreign=False)), None)
    if side is None:
        letters = ({"", "m"}, {"m"}, {"T", "B"}, {"t", "b"})
        side = next((n for n in rest if set(values[n]) in letters), None)
    if side is not None:
        found["side"] = side
    rest = [n for n in rest if n != side and any(values[n])]
    if len(rest) == 2:  # EAGLE's .mnt
        found |= {"value": rest[0], "package": rest[1]}
    elif rest:
        found["package"] = rest[0]
    elif any(len(row) > 4 for row in usual) and side is None:
        found["package"] = 4
    return found


def _may_be_angles(values: Sequence[str]) -> bool:
    found = [angle_in(value) for value in values if value]
    angles = [angle for angle in found if angle is not None]
    if not angles or len(angles) < 0.9 * len(found) or max(map(abs, angles)) > 360:
        return False
    return _angle_share(values) >= _LIKELY_ANGLES


def _angle_share(values: Sequence[str]) -> float:
    """Return the share of values that are multiples of 15°, as most rotations on boards are."""
    angles = [angle_in(value) for value in values if value]
    usual = sum(angle is not None and abs(angle / 15 - round(angle / 15)) < 1e-6 for angle in angles)
    return usual / max(len(angles), 1)
