"""Sentences for people that have a code and values for programs: remarks of an import, notes of a calibration."""

from __future__ import annotations

from collections.abc import Mapping


class Note(str):
    """A sentence on what a person should check, as text; programs and translations go by its code and its values.

    Attributes:
        code: what it says (docs/codes.md).
        values: what the sentence states, such as numbers and designators, as they are written in it.
    """

    __slots__ = ("code", "values")
    code: str
    values: Mapping[str, str]

    def __new__(cls, code: str, sentence: str, **values: object) -> Note:
        """Create it; `values` are written as in the sentence."""
        note = super().__new__(cls, sentence)
        note.code, note.values = code, {name: str(value) for name, value in values.items()}
        return note

    def __getnewargs_ex__(self) -> tuple[tuple[str, str], dict[str, str]]:
        """Return the arguments of a copy, for `copy` and `pickle`."""
        return (self.code, str(self)), dict(self.values)
