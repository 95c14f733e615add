"""Recognise what the columns of a centroid file hold: by the words of the header, and by the values below it.

The words are in `table_words.toml`.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path

from vaoi_station.board_data.design import Side
from vaoi_station.board_data.source_text import number_of
from vaoi_station.errors import InputError

COLUMNS = ("ref", "x", "y", "rotation", "side", "package", "value", "fitted")
REQUIRED = ("ref", "x", "y")

NUMBER = re.compile(
    r"^([+\-−]?)(\d+[.,]?\d*|[.,]\d+|\d{1,3}(?:,\d{3})+(?:\.\d*)?|\d{1,3}(?:\.\d{3})+(?:,\d*)?|\d{1,3}(?:'\d{3})+(?:[.,]\d*)?)"
    r"(?:(E[+-]?\d+))?\s*(mm|mils?|thou|inch(?:es)?|in|cm|[uµμ]m|\"|″|[°º]|deg(?:rees?)?|grad)?$",
    re.IGNORECASE,
)
"""A number with its unit, as tables write it: sign, digits with separators, exponent, unit."""
_UMLAUTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "é": "e", "°": " deg "})


def _words(group: str) -> dict[str, tuple[str, ...]]:
    """Return the lists of one group of `table_words.toml`."""
    return {name: tuple(words.split()) for name, words in _TABLE[group].items()}


_TABLE = tomllib.loads((resources.files(__package__) / "table_words.toml").read_text(encoding="utf-8"))
_VALUES = {name: frozenset(words) for name, words in _words("values").items()}
_HEADERS = _words("headers")
_OTHER, _MIRRORED, _UPRIGHT = (frozenset(_HEADERS.pop(name)) for name in ("other", "mirrored", "upright"))
_UNIT_HEADERS = frozenset(_HEADERS.pop("unit"))
_STATED_REF = frozenset(_HEADERS["ref"])
_HEADERS["ref"] = (*_HEADERS["ref"], *_HEADERS.pop("maybe_ref"))
_HEADERS["side"] = (*_HEADERS["side"], *sorted(_MIRRORED), *sorted(_UPRIGHT))
_HEADERS["fitted"] = (*_HEADERS["fitted"], *sorted(_VALUES["not_fitted"]))
_YES, _NO, _NOT_FITTED = _VALUES["yes"] | {"1"}, _VALUES["no"] | {"0"}, _VALUES["not_fitted"]
_TOP_WORDS, _BOTTOM_WORDS = _VALUES["top"], _VALUES["bottom"]
_MIRROR_TOP = _NO | {"", "none", "normal", "-", "f"}
_MIRROR_BOTTOM = _YES | {"t", "mirror", "mirrored", "m", "gespiegelt", "flipped"}
_BESIDE_AXIS = _words("beside_axis")
_RANKS = {"center": 0, "place": 1, "": 2, "position": 3, "part": 4, "origin": 5}
"""Which x and y are preferred: the centre of the body to the origin of the CAD part."""
_RANKED = tuple((word, _RANKS[kind]) for kind, words in _BESIDE_AXIS.items() for word in words)
_BESIDE = "|".join(sorted((word for word, _ in _RANKED), key=len, reverse=True))
_AXIS = {axis: re.compile(rf"^((?:{_BESIDE})*){axis}((?:{_BESIDE})*)$") for axis in "xy"}
_DESIGNATOR = re.compile(r"^([A-Za-z]{1,5})[-_$ ]?(\d{1,5}|\?)([A-Za-z]{0,2}|[-_.:/]\w{1,3})$")
_WEAK_ROTATION = frozenset(("r", "phi", "direction", "drehrichtung", "orient", "ausrichtung"))
"""Headers that are those of a rotation only if the values are angles."""
_BARE_REF = re.compile(r"^[A-Za-z*_][\w*.\-/+$]*$")
_LEAST_DESIGNATORS = 0.3
"""Score of a column of designators; below it values do not decide."""
_CLEARLY_DESIGNATORS = 0.8
_SAME_SCORE = 0.1
_LIKELY_ANGLES = 0.5
"""Share of angles that are multiples of 15° in a column of rotations."""
NOT_THERE = "none"
"""What the user states as the column of a rotation that the file does not have."""


@dataclass(frozen=True)
class TableLayout:
    """What the columns of a table hold."""

    columns: Mapping[str, int]
    header: int = -1
    """Index of the record with the header; −1 without one."""
    first: int = 0
    """Index of the first record with a part."""
    all_on: Side | None = None
    """The side of all parts, as the user states it."""
    headers: tuple[str, ...] = ()
    without_rotation: bool = False
    """Whether the user states that there is no rotation."""
    unused: tuple[str, ...] = ()
    """Headers of the columns that are not used; of a table without header their numbers."""
    sides: Mapping[str, Side] = field(default_factory=dict)
    """The side that each value of its column states."""
    unit: int | None = None
    """The column of the unit of each line."""
    mirror: int | None = None
    """A column beside that of the side which says which parts are mirrored."""

    def header_of(self, name: str) -> str:
        """Return the header of a column; empty without one."""
        at = self.columns.get(name, len(self.headers))
        return self.headers[at] if at < len(self.headers) else ""

    @property
    def last(self) -> int:
        """Index of the last column that every part must have."""
        return max(self.columns[name] for name in REQUIRED)


def plain_key(cell: str) -> str:
    """Return a header as lower-case letters, without unit, brackets and punctuation: `Center-X(mm)` is `centerx`."""
    text = re.sub(r"[\(\[{].*?[\)\]}]", " ", cell.lower().translate(_UMLAUTS))
    words = re.findall(r"[a-z]+", text)
    while len(words) > 1 and words[-1] in _VALUES["units"]:
        words.pop()
    key = "".join(words)
    attached = re.fullmatch(r"(.*[xy])(mm|mils?|inch)", key)  # "XMM"
    return attached[1] if attached else key


def is_known_header(words: str) -> bool:
    """Return whether words are the header of one column."""
    key = plain_key(words)
    if re.search(r"[\)\]}]\s*\w", words):  # "PosY [mm] Ref" are two
        return False
    return bool(key) and (
        key in _OTHER or any(key in names for names in _HEADERS.values()) or any(p.match(key) for p in _AXIS.values())
    )


def is_ref_header(words: str) -> bool:
    """Return whether words are the header of the designators."""
    return plain_key(words) in _HEADERS["ref"]


def number_in(cell: str, decimal: str | None = None) -> float | None:
    """Return the number of a cell, which may have a unit; None if it has none.

    `decimal` is the decimal separator of the table, if it is known: `1,234` is above a thousand beside `1.5`.
    """
    match = NUMBER.match(cell.strip())
    if match is None:
        return None
    text = match[2].replace("'", "")
    if "." in text and "," in text:
        decimal = "," if text.rindex(",") > text.rindex(".") else "."
    elif max(text.count(","), text.count(".")) > 1:
        decimal = "." if "," in text else ","
    elif decimal is None or not _may_be_thousands(text):
        decimal = "," if "," in text else "."
    text = text.replace("." if decimal == "," else ",", "").replace(",", ".")
    return number_of(f"{match[1].replace('−', '-')}{text}{match[3] or ''}")


def _may_be_thousands(digits: str) -> bool:
    """Return whether the only separator of a number may separate thousands: `1,234`."""
    return re.fullmatch(r"[1-9]\d{0,2}[.,]\d{3}", digits) is not None


def decimal_separator(cells: Iterable[str]) -> str | None:
    """Return the decimal separator that numbers of a table show; None if they show none, or both."""
    found = set()
    for cell in cells:
        match = NUMBER.match(cell.strip())
        separators = re.findall(r"[.,]", match[2]) if match else []
        if match and separators and (len(set(separators)) == 2 or not _may_be_thousands(match[2])):
            several = len(separators) > 1 and len(set(separators)) == 1
            found.add({",": ".", ".": ","}[separators[0]] if several else separators[-1])
    return found.pop() if len(found) == 1 else None


def header_cells(cells: Sequence[str]) -> list[str]:
    """Return the cells of a header without the signs of a comment: `# RefDes`, `Fields: Part ID` of Proteus."""
    found = [cell.strip().lstrip("\ufeff") for cell in cells]
    if found:
        found[0] = re.sub(r"^(?:[#!%;*/]+|fields\s*:)\s*", "", found[0], flags=re.IGNORECASE)
    return found


def named_columns(header: Sequence[str]) -> dict[str, list[int]]:
    """Return role → the columns whose headers name it, the preferred one first."""
    keys = [plain_key(cell) for cell in header]
    found: dict[str, list[int]] = {}
    for axis in "xy":
        ranked = [(_axis_rank(axis, key), n) for n, key in enumerate(keys) if _AXIS[axis].match(key)]
        found[axis] = [n for _, n in sorted(ranked)]
    for role, words in _HEADERS.items():
        ranked = [(words.index(key), n) for n, key in enumerate(keys) if key in words]
        found[role] = [n for _, n in sorted(ranked)]
    return {role: columns for role, columns in found.items() if columns}


def _axis_rank(axis: str, key: str) -> int:
    match = _AXIS[axis].match(key)
    words = match[1] + match[2] if match else ""
    ranks = [rank for word, rank in _RANKED if word in words]
    # "Ref X" is the origin, "Part Center X" the centre.
    return min((r for r in ranks if r < 2), default=max(ranks, default=2))


def has_required(columns: Mapping[str, object]) -> bool:
    """Return whether designator, x and y are among the columns."""
    return all(name in columns for name in REQUIRED)


def columns_by_header(header: Sequence[str], rows: Sequence[Sequence[str]]) -> dict[str, int]:
    """Return role → column, by the words of the header; the designators are chosen by their values."""
    named = named_columns(header)
    found: dict[str, int] = {}
    pairs = [(x, y) for x in named.get("x", ()) for y in named.get("y", ())]
    # A pair may be empty where another one is filled.
    pairs = [p for p in pairs if any(number_in(v) is not None for n in p for v in _values(rows, n))] or pairs
    if pairs:
        # Both axes are of one kind: no "Mid X" beside "Ref Y".
        x, y = min(pairs, key=lambda p: (_kind(header[p[0]]) != _kind(header[p[1]]), named["x"].index(p[0])))
        found |= {"x": x, "y": y}
    taken = set(found.values())
    if (ref := _designators(header, rows, taken)) is not None:
        found["ref"] = ref
        taken.add(ref)
    for role in ("side", "rotation", "fitted", "package", "value"):
        column = next((n for n in named.get(role, ()) if n not in taken and _fits(role, n, rows, header)), None)
        if column is not None:
            found[role] = column
            taken.add(column)
    return found


def _kind(header: str) -> str:
    """Return the words beside x or y in a header."""
    return re.sub(r"[xy]", "", plain_key(header))


def _fits(role: str, column: int, rows: Sequence[Sequence[str]], header: Sequence[str]) -> bool:
    """Return whether the values of a column can be of the role that its header names.

    Words such as `Layer`, `Place`, `Type` and `Direction` are used for other things as well.
    """
    values = [value for value in _values(rows, column) if value]
    if role == "rotation" and values and plain_key(header[column]) in _WEAK_ROTATION:
        return sum(angle_in(value) is not None for value in values) * 2 > len(values)
    if role == "fitted" and values:
        known = (
            _YES | _NO | _NOT_FITTED | {"fitted", "populated", "mounted", "placed", "bestueckt", "t", "f", "nf", "-"}
        )
        return all(value.lower() in known or plain_key(value) in known for value in values) or any(
            plain_key(value) in _NOT_FITTED for value in values
        )
    if role == "side" and plain_key(header[column]) in _UPRIGHT | _MIRRORED:
        return all(value.lower() in _MIRROR_TOP | _MIRROR_BOTTOM for value in values)
    return True


def _values(rows: Sequence[Sequence[str]], column: int) -> list[str]:
    return [row[column] for row in rows if column < len(row)]


def _designators(header: Sequence[str], rows: Sequence[Sequence[str]], taken: set[int]) -> int | None:
    """Return the column of the designators: the one that is named so, else the one whose values look most like it."""
    keys = [plain_key(cell) for cell in header]
    named = [n for n in named_columns(header).get("ref", ()) if n not in taken]
    stated = [n for n in named if keys[n] in _STATED_REF]
    # Row numbers are no designators where another column has some.
    several = [
        n
        for n in stated
        if len(set(_values(rows, n))) * 2 > len(_values(rows, n))
        and not all(number_in(value) is not None for value in _values(rows, n))
    ]
    if several or (stated and len(named) == len(stated)):
        return (several or stated)[0]
    candidates = named
    free = [n for n, key in enumerate(keys) if n not in taken and not _is_of_other_role(key)]
    scores = {n: _designator_score(_values(rows, n)) for n in (candidates or free)}
    best = max(scores, key=lambda n: scores[n], default=None)
    if best is None or not candidates:
        return best if best is not None and scores[best] >= _CLEARLY_DESIGNATORS else None
    if scores[best] < _LEAST_DESIGNATORS:
        return candidates[0]
    return next(n for n in candidates if scores[n] >= scores[best] - _SAME_SCORE)


def _is_of_other_role(key: str) -> bool:
    """Return whether a header names something else than designators."""
    named = key in _OTHER or any(key in names for role, names in _HEADERS.items() if role != "ref")
    return named or any(pattern.match(key) for pattern in _AXIS.values())


def _designator_score(values: Sequence[str]) -> float:
    """Return from 0 to 1 how much values look like designators: different ones of letters, then a number."""
    if not values:
        return 0.0
    total = 0.0
    for value in values:
        match = _DESIGNATOR.match(value)
        if match is not None:
            prefix = match[1].lower()
            usual = 1.0 if prefix in _VALUES["prefixes"] else 0.8 if len(prefix) <= 2 else 0.6
            total += usual - (0.1 if match[3] else 0.0)
    # On panels every designator occurs once a board, but values and packages occur more often.
    return total / len(values) * math.sqrt(len(set(values)) / len(values))


def is_usual_designator(word: str) -> bool:
    """Return whether a word is a designator with usual letters: `R12`, `IC3A`."""
    match = _DESIGNATOR.match(word.strip())
    return match is not None and match[1].lower() in _VALUES["prefixes"]


def angle_in(cell: str) -> float | None:
    """Return the angle of a cell in degrees: a number, or EAGLE's `R90` and `MR90`."""
    match = re.fullmatch(r"[MS]*R(-?\d+(?:\.\d+)?)", cell.strip(), re.IGNORECASE)
    return number_of(match[1]) if match else number_in(cell)


def is_comment(cells: Sequence[str]) -> bool:
    """Return whether a line is a comment."""
    return bool(cells) and cells[0].startswith(("#", "//", "!"))


def looks_like_part(cells: Sequence[str]) -> bool:
    """Return whether a line has a word and at least two numbers, as every part has."""
    numbers = sum(number_in(cell) is not None for cell in cells)
    return len(cells) > 2 and numbers >= 2 and numbers < len(cells)


def sides_of(values: Iterable[str], header: str = "") -> dict[str, Side]:
    """Return the side that each value of a column states; values that state none are absent.

    The letters and numbers of a column have a meaning together only: `B` is the bottom beside `T`, and the
    "Bestückungsseite", the top, beside `L`. EAGLE counts layers 1 and 16, KiCad 0 and 31, others 1 and 2.
    """
    kinds = {value.strip() for value in values}
    key = plain_key(header)
    if key in _MIRRORED | _UPRIGHT:
        top, bottom = (_MIRROR_TOP, _MIRROR_BOTTOM) if key in _MIRRORED else (_MIRROR_BOTTOM, _MIRROR_TOP)
        return {kind: "top" if kind.lower() in top else "bottom" for kind in kinds if kind.lower() in top | bottom}
    found: dict[str, Side] = {}
    legend = dict(re.findall(r"(\w+)\s*=\s*([A-Za-z]+)", header))
    for kind in kinds:
        if (side := side_in_words(legend.get(kind, kind))) is not None:
            found[kind] = side
    letters = {kind.lower(): kind for kind in kinds if len(kind) <= 2 and kind.isalpha()}
    for pair in _TABLE["values"]["letters"].split():
        top_letter, bottom_letter = pair.split("/")
        alone = set(letters) in ({"t"}, {"b"}, {"f"}) and letters.keys() <= {top_letter, bottom_letter}
        if set(letters) == {top_letter, bottom_letter} or (alone and key != "seite"):
            found |= {kind: "top" if c == top_letter else "bottom" for c, kind in letters.items()}
            break
    if "m" in letters and letters.keys() <= {"m", "t"}:
        found |= {kind: "bottom" if c == "m" else "top" for c, kind in letters.items()}
    numbers = {kind: int(match[1]) for kind in kinds if (match := re.fullmatch(r"[LM]?(\d+)", kind, re.IGNORECASE))}
    if len(numbers) == 2 and min(numbers.values()) in (0, 1) and not numbers.keys() & found.keys():
        found |= {kind: "top" if n == min(numbers.values()) else "bottom" for kind, n in numbers.items()}
    return found


def unit_column(headers: Sequence[str]) -> int | None:
    """Return the column of the unit of each line; None if there is none."""
    return next((n for n, header in enumerate(headers) if plain_key(header) in _UNIT_HEADERS), None)


def mirror_column(headers: Sequence[str], columns: Mapping[str, int]) -> int | None:
    """Return a column of mirrored parts beside that of the side; None if there is none."""
    beside = (n for n, header in enumerate(headers) if plain_key(header) in _MIRRORED and n != columns.get("side"))
    return next(beside, None) if "side" in columns else None


def repeated_columns(headers: Sequence[str], columns: Mapping[str, int]) -> list[str]:
    """Return the required columns whose headers occur twice, as those of tables side by side do."""
    return [name for name in REQUIRED if headers.count(headers[columns[name]]) > 1 and headers[columns[name]]]


def are_numbers(sides: Mapping[str, Side]) -> bool:
    """Return whether sides are stated by numbers, whose meaning differs from program to program."""
    return any(kind.isdigit() for kind in sides)


def side_in_words(text: str) -> Side | None:
    """Return the side that words state, such as `Copper Top`; None if they state none, or both."""
    words = re.findall(r"[a-z]+", text.lower().translate(_UMLAUTS))
    if any(c.isdigit() for c in text):
        return None
    words.append("".join(words))
    top, bottom = any(w in _TOP_WORDS for w in words), any(w in _BOTTOM_WORDS for w in words)
    return None if top == bottom else "top" if top else "bottom"


def is_fitted(cell: str, header: str, others: Iterable[str], value: str = "") -> bool:
    """Return whether a part is fitted, by its cell of column `fitted`, its header, and other cells.

    A value may have the word beside another one: `10k DNP`.
    """
    words = re.findall(r"[a-z0-9]+", value.lower())
    plain = (re.sub(r"[^a-z0-9]", "", text.lower().translate(_UMLAUTS)) for text in (cell, value, *others))
    if not _NOT_FITTED.isdisjoint(words) or any(text in _NOT_FITTED for text in plain):
        return False
    word = cell.strip().lower()
    # A column "DNP" states of which parts the opposite holds.
    return word not in _YES if plain_key(header) in _NOT_FITTED else word not in _NO | {"-"}


def letters_of_unfitted(values: Iterable[str]) -> frozenset[str]:
    """Return the letters of a column that say that a part is not fitted: F beside T, NF beside F."""
    kinds = {value.strip().lower() for value in values} - {""}
    return frozenset("f") if kinds == {"t", "f"} else frozenset(("nf",)) if kinds <= {"f", "nf"} else frozenset()


def marks_only_fitted(values: Iterable[str], header: str) -> bool:
    """Return whether a column marks the parts that are fitted, so that an empty cell, or a dash, says the opposite."""
    kinds = {value.strip().lower() for value in values} - {"", "-"}
    return bool(kinds) and kinds <= _YES and plain_key(header) not in _NOT_FITTED


def doubtful_columns(layout: TableLayout, rows: Sequence[Sequence[str]]) -> dict[str, list[int]]:
    """Return which unused columns may hold the rotation or the side, where the header does not show which does.

    A column that is not understood may be anything that its values allow: it must not be taken as absent.
    """
    found: dict[str, list[int]] = {}
    width = max((len(row) for row in rows), default=0)
    free = [n for n in range(width) if n not in layout.columns.values()]
    headers = layout.headers

    def is_foreign(n: int) -> bool:
        """Return whether the header of a column is none that is known to hold something else."""
        key = plain_key(headers[n]) if n < len(headers) else ""
        if n in layout.columns.values():
            return False
        named = key in _OTHER or any(
            key in names for role, names in _HEADERS.items() if role not in ("side", "rotation")
        )
        return not named and not any(pattern.match(key) for pattern in _AXIS.values())

    if "rotation" not in layout.columns and not layout.without_rotation:
        found["rotation"] = [n for n in free if is_foreign(n) and _may_be_angles(_values(rows, n))]
    if "side" not in layout.columns and layout.all_on is None:
        found["side"] = [n for n in free if _may_be_sides(_values(rows, n), is_foreign(n))]
    return {role: columns for role, columns in found.items() if columns}


def _may_be_angles(values: Sequence[str]) -> bool:
    found = [angle_in(value) for value in values if value]
    angles = [angle for angle in found if angle is not None]
    if not angles or len(angles) < 0.9 * len(found) or max(map(abs, angles)) > 360:
        return False
    return angle_share(values) >= _LIKELY_ANGLES


def angle_share(values: Sequence[str]) -> float:
    """Return the share of values that are multiples of 15°, as most rotations on boards are."""
    angles = [angle_in(value) for value in values if value]
    usual = sum(angle is not None and abs(angle / 15 - round(angle / 15)) < 1e-6 for angle in angles)
    return usual / max(len(angles), 1)


def _may_be_sides(values: Sequence[str], is_foreign: bool) -> bool:
    present = [value for value in values if value]
    kinds = set(present)
    if not present or len(kinds) > 3 or len(present) < 0.9 * len(values):
        return False
    plain = {"".join(re.findall(r"[a-z]+", v.lower().translate(_UMLAUTS))) for v in kinds}
    letters = {kind.lower() for kind in kinds}
    if all(side_in_words(kind) is not None for kind in kinds) or letters in ({"t", "b"}, {"f", "b"}):
        return True
    if is_foreign and letters in ({"t"}, {"b"}):
        return True
    if not is_foreign or len(kinds) != 2:
        return False
    if all(re.fullmatch(r"L?(0|1|2|16|31)", kind) for kind in kinds):
        return True
    # Two words in a column of an unknown name may be the sides in another language.
    words = all(number_in(kind) is None and len(kind) < 16 for kind in kinds)
    return words and len(present) > 3 and not plain & _VALUES["technology"]


def columns_without_header(rows: Sequence[Sequence[str]]) -> dict[str, int] | None:
    """Return the columns of a table without a header: designator, x, y, rotation, then side, value and package.

    Returns None if the lines are of another kind, or if x or y looks more like a rotation than the fourth column.
    """
    usual = [row for row in rows if is_bare_part(row)]
    if not usual or 2 * len(usual) < sum(len(row) > 1 for row in rows):
        return None
    shares = [angle_share(_values(usual, n)) for n in (1, 2, 3)]
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
    if any(len(row) != width for row in usual) and any(row[4:5] == ["m"] or row[4:5] == ("m",) for row in usual):
        return found | {"package": 4}  # Allegro: "m" is an additional cell
    mirrored = {"", "m"}
    side = next((n for n in rest if _may_be_sides(_values(usual, n), is_foreign=False)), None)
    if side is None:
        side = next((n for n in rest if set(_values(usual, n)) in (mirrored, {"m"}, {"T", "B"}, {"t", "b"})), None)
    if side is not None:
        found["side"] = side
        rest.remove(side)
    rest = [n for n in rest if any(_values(usual, n))]
    if len(rest) == 2:  # EAGLE's .mnt
        found |= {"value": rest[0], "package": rest[1]}
    elif rest:
        found["package"] = rest[0]
    elif any(len(row) > 4 for row in usual) and side is None:
        found["package"] = 4
    return found


def is_bare_part(row: Sequence[str]) -> bool:
    """Return whether a line without a header is designator, x, y and rotation."""
    return len(row) >= 4 and bool(_BARE_REF.match(row[0])) and all(number_in(c) is not None for c in row[1:4])


def rival_designators(headers: Sequence[str], rows: Sequence[Sequence[str]], chosen: int) -> list[str]:
    """Return the headers of other columns that may hold the designators as well."""
    keys = [plain_key(header) for header in headers]
    if chosen >= len(keys) or keys[chosen] in _STATED_REF:
        return []
    named = [n for n in named_columns(headers).get("ref", ()) if n != chosen]
    return [headers[n] for n in named if _designator_score(_values(rows, n)) >= _LEAST_DESIGNATORS]


def given_columns(
    path: Path, given: Sequence[tuple[str, str]], headers: Sequence[str], most: int
) -> tuple[dict[str, int], Side | None, bool]:
    """Return the columns that the user names, the side of all parts, and whether there is no rotation.

    Raises:
        InputError: a column does not exist.
    """
    columns: dict[str, int] = {}
    all_on: Side | None = None
    without_rotation = False
    for name, at in given:
        if name == "side" and at.lower() in ("top", "bottom"):
            all_on = "top" if at.lower() == "top" else "bottom"
        elif name == "rotation" and at.lower() == NOT_THERE:
            without_rotation = True
        else:
            columns[name] = _column(path, name, at, headers, most)
    return columns, all_on, without_rotation


def _column(path: Path, name: str, at: str, headers: Sequence[str], most: int) -> int:
    """Return the index of a column that is given by its header, or by a number up to `most`."""
    if re.fullmatch(r"[0-9]{1,6}", at) and 1 <= int(at) <= most:
        return int(at) - 1
    same = [n for n, header in enumerate(headers) if header.strip().lower() == at.strip().lower()]
    keys = [plain_key(cell) for cell in headers]
    if not same and plain_key(at) and plain_key(at) in keys:
        same = [keys.index(plain_key(at))]
    if same:
        return same[0]
    raise InputError.field(path, f"--columns {name}", at, f"a number from 1 to {most}, or a header of {list(headers)}")
