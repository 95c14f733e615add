"""The words and numbers of centroid files: what a header names, and what a cell states.

The words are in `table_words.toml`.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Iterable, Mapping, Sequence
from importlib import resources

from vaoi_station.board_data.design import Side
from vaoi_station.board_data.source_text import number_of

NUMBER = re.compile(
    r"^([+\-−]?)(\d+[.,]?\d*|[.,]\d+|\d{1,3}(?:,\d{3})+(?:\.\d*)?|\d{1,3}(?:\.\d{3})+(?:,\d*)?|\d{1,3}(?:'\d{3})+(?:[.,]\d*)?)"
    r"(?:(E[+-]?\d+))?\s*(mm|mils?|thou|inch(?:es)?|in|cm|[uµμ]m|\"|″|[°º]|deg(?:rees?)?|grad)?$",
    re.IGNORECASE,
)
"""A number with its unit, as tables write it: sign, digits with separators, exponent, unit."""
_UMLAUTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "é": "e", "°": " deg "})
_TABLE = tomllib.loads((resources.files(__package__) / "table_words.toml").read_text(encoding="utf-8"))
VALUES = {name: frozenset(words.split()) for name, words in _TABLE["values"].items()}
HEADERS = {name: tuple(words.split()) for name, words in _TABLE["headers"].items()}
"""Role → headers of its column, the preferred one first."""
_OTHER, MIRRORED, UPRIGHT = (frozenset(HEADERS.pop(name)) for name in ("other", "mirrored", "upright"))
UNIT_HEADERS, STATED_REF = frozenset(HEADERS.pop("unit")), frozenset(HEADERS["ref"])
HEADERS["ref"] = (*HEADERS["ref"], *HEADERS.pop("maybe_ref"))
HEADERS["side"] = (*HEADERS["side"], *sorted(MIRRORED), *sorted(UPRIGHT))
HEADERS["fitted"] = (*HEADERS["fitted"], *sorted(VALUES["not_fitted"]))
_YES, _NO, _NOT_FITTED = VALUES["yes"] | {"1"}, VALUES["no"] | {"0"}, VALUES["not_fitted"]
_FITTED_WORDS = _YES | _NO | {"fitted", "populated", "mounted", "placed", "bestueckt", "t", "f", "nf", "-"}
_MIRROR_TOP = _NO | {"", "none", "normal", "-", "f"}
_MIRROR_BOTTOM = _YES | {"t", "mirror", "mirrored", "m", "gespiegelt", "flipped"}
_RANKS = {"center": 0, "place": 1, "": 2, "position": 3, "part": 4, "origin": 5}
"""Which x and y are preferred: the centre of the body to the origin of the CAD part."""
_RANKED = tuple((word, _RANKS[kind]) for kind, words in _TABLE["beside_axis"].items() for word in words.split())
_BESIDE = "|".join(sorted((word for word, _ in _RANKED), key=len, reverse=True))
_AXIS = {axis: re.compile(rf"^((?:{_BESIDE})*){axis}((?:{_BESIDE})*)$") for axis in "xy"}
_DESIGNATOR = re.compile(r"^([A-Za-z]{1,5})[-_$ ]?(\d{1,5}|\?)([A-Za-z]{0,2}|[-_.:/]\w{1,3})$")


# Headers.


def plain_key(cell: str) -> str:
    """Return a header as lower-case letters, without unit, brackets and punctuation: `Center-X(mm)` is `centerx`."""
    text = re.sub(r"[\(\[{].*?[\)\]}]", " ", cell.lower().translate(_UMLAUTS))
    words = re.findall(r"[a-z]+", text)
    while len(words) > 1 and words[-1] in VALUES["units"]:
        words.pop()
    key = "".join(words)
    attached = re.fullmatch(r"(.*[xy])(mm|mils?|inch)", key)  # "XMM"
    return attached[1] if attached else key


def is_header(key: str, but: Collection[str] = ()) -> bool:
    """Return whether a header, as its plain key, is known, but for those of some roles."""
    named = key in _OTHER or any(key in names for role, names in HEADERS.items() if role not in but)
    return named or any(pattern.match(key) for pattern in _AXIS.values())


def is_one_header(words: str) -> bool:
    """Return whether words are the header of one column; "PosY [mm] Ref" are two."""
    key = plain_key(words)
    return bool(key) and not re.search(r"[\)\]}]\s*\w", words) and is_header(key)


def header_cells(cells: Sequence[str]) -> list[str]:
    """Return the cells of a header without the signs of a comment: `# RefDes`, `Fields: Part ID` of Proteus."""
    found = [cell.strip().lstrip("\ufeff") for cell in cells]
    if found:
        found[0] = re.sub(r"^(?:[#!%;*/]+|fields\s*:)\s*", "", found[0], flags=re.IGNORECASE)
    return found


def named_columns(header: Sequence[str]) -> dict[str, list[int]]:
    """Return role → the columns whose headers name it, the preferred one first."""
    keys = [plain_key(cell) for cell in header]
    found: dict[str, list[tuple[int, int]]] = {}
    for axis, pattern in _AXIS.items():
        matches = ((n, match) for n, key in enumerate(keys) if (match := pattern.match(key)))
        found[axis] = [(_axis_rank(match[1] + match[2]), n) for n, match in matches]
    for role, words in HEADERS.items():
        found[role] = [(words.index(key), n) for n, key in enumerate(keys) if key in words]
    return {role: [n for _, n in sorted(columns)] for role, columns in found.items() if columns}


def _axis_rank(words: str) -> int:
    """Return how much a place with words beside its axis is preferred; "Ref X" is the origin, "Part Center X" not."""
    ranks = [rank for word, rank in _RANKED if word in words]
    return min((r for r in ranks if r < 2), default=max(ranks, default=2))


# Numbers.


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


def numbers_in(cells: Iterable[str]) -> int:
    """Return how many cells are numbers."""
    return sum(number_in(cell) is not None for cell in cells)


def angle_in(cell: str) -> float | None:
    """Return the angle of a cell in degrees: a number, or EAGLE's `R90` and `MR90`."""
    match = re.fullmatch(r"[MS]*R(-?\d+(?:\.\d+)?)", cell.strip(), re.IGNORECASE)
    return number_of(match[1]) if match else number_in(cell)


# Lines.


def is_comment(cells: Sequence[str]) -> bool:
    """Return whether a line is a comment."""
    return bool(cells) and cells[0].startswith(("#", "//", "!"))


def looks_like_part(cells: Sequence[str]) -> bool:
    """Return whether a line has a word and at least two numbers, as every part has."""
    return len(cells) > 2 and 2 <= numbers_in(cells) < len(cells)


def is_usual_designator(word: str) -> bool:
    """Return whether a word is a designator with usual letters: `R12`, `IC3A`."""
    return designator_score(word.strip()) >= 0.9


def designator_score(word: str) -> float:
    """Return from 0 to 1 how much a word looks like a designator: usual letters, then a number."""
    if (match := _DESIGNATOR.match(word)) is None:
        return 0.0
    prefix = match[1].lower()
    usual = 1.0 if prefix in VALUES["prefixes"] else 0.8 if len(prefix) <= 2 else 0.6
    return usual - (0.1 if match[3] else 0.0)


# Sides.


def side_in_words(text: str) -> Side | None:
    """Return the side that words state, such as `Copper Top`; None if they state none, or both."""
    words = re.findall(r"[a-z]+", text.lower().translate(_UMLAUTS))
    if any(c.isdigit() for c in text):
        return None
    words.append("".join(words))
    top, bottom = (not VALUES[side].isdisjoint(words) for side in ("top", "bottom"))
    return None if top == bottom else "top" if top else "bottom"


def sides_of(values: Iterable[str], header: str = "") -> dict[str, Side]:
    """Return the side that each value of a column states; values that state none are absent.

    The letters and numbers of a column have a meaning together only: `B` is the bottom beside `T`, and the
    "Bestückungsseite", the top, beside `L`. EAGLE counts layers 1 and 16, KiCad 0 and 31, others 1 and 2.
    """
    kinds = {value.strip() for value in values}
    key = plain_key(header)
    if key in MIRRORED | UPRIGHT:
        top, bottom = (_MIRROR_TOP, _MIRROR_BOTTOM) if key in MIRRORED else (_MIRROR_BOTTOM, _MIRROR_TOP)
        return {kind: "top" if kind.lower() in top else "bottom" for kind in kinds if kind.lower() in top | bottom}
    legend = dict(re.findall(r"(\w+)\s*=\s*([A-Za-z]+)", header))
    stated = {kind: side_in_words(legend.get(kind, kind)) for kind in kinds}
    found: dict[str, Side] = {kind: side for kind, side in stated.items() if side is not None}
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


def may_mark_mirrored(values: Iterable[str]) -> bool:
    """Return whether all values of a column may say which parts are mirrored."""
    return all(value.lower() in _MIRROR_TOP | _MIRROR_BOTTOM for value in values)


def may_be_sides(values: Sequence[str], is_foreign: bool) -> bool:
    """Return whether the values of a column may be sides; `is_foreign`: its header is not known."""
    present = [value for value in values if value]
    kinds = set(present)
    if not present or len(kinds) > 3 or len(present) < 0.9 * len(values):
        return False
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
    plain = {"".join(re.findall(r"[a-z]+", kind.lower().translate(_UMLAUTS))) for kind in kinds}
    words = all(number_in(kind) is None and len(kind) < 16 for kind in kinds)
    return words and len(present) > 3 and not plain & VALUES["technology"]


# Whether parts are fitted.


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


def may_state_fitted(values: Sequence[str]) -> bool:
    """Return whether the values of a column can state which parts are fitted."""
    keys = [plain_key(value) for value in values]
    known = _FITTED_WORDS | _NOT_FITTED
    return not _NOT_FITTED.isdisjoint(keys) or all(
        value.lower() in known or key in known for value, key in zip(values, keys, strict=True)
    )


def cells_of_unfitted(values: Iterable[str], header: str) -> frozenset[str]:
    """Return what cells of a column say, in lower case, beside its other values: that a part is not fitted.

    It is F beside T, NF beside F, and an empty cell or a dash where a column only marks the parts that are fitted.
    """
    all_kinds = {value.strip().lower() for value in values}
    kinds, marked = all_kinds - {""}, all_kinds - {"", "-"}
    found = {"f"} if kinds == {"t", "f"} else {"nf"} if kinds <= {"f", "nf"} else set[str]()
    if marked and marked <= _YES and plain_key(header) not in _NOT_FITTED:
        found |= {"", "-"}
    return frozenset(found)


def are_numbers(sides: Mapping[str, Side]) -> bool:
    """Return whether sides are stated by numbers, whose meaning differs from program to program."""
    return any(kind.isdigit() for kind in sides)
