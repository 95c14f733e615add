"""Sentences with a code and values."""

from __future__ import annotations

from vaoi_station.model.note import Note


def test_a_note_is_its_sentence_and_has_its_values_as_they_are_written() -> None:
    note = Note("parts-outside", "2 parts lie outside: R1, R2.", count=2, names="R1, R2")
    assert note == "2 parts lie outside: R1, R2."
    assert (note.code, note.values) == ("parts-outside", {"count": "2", "names": "R1, R2"})
    assert len({note, Note("other-code", str(note))}) == 1, "notes are compared by their sentences"
