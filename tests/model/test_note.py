"""Sentences with a code and values."""

from __future__ import annotations

import copy
import pickle

from vaoi_station.model.note import Note


def test_a_note_is_its_sentence_and_has_its_values_as_they_are_written() -> None:
    note = Note("parts-outside", "2 parts lie outside: R1, R2.", count=2, names="R1, R2")
    assert note == "2 parts lie outside: R1, R2."
    assert (note.code, note.values) == ("parts-outside", {"count": "2", "names": "R1, R2"})
    assert len({note, Note("other-code", str(note))}) == 1, "notes are compared by their sentences"


def test_copies_have_code_and_values() -> None:
    """Results of an import and of a calibration may pass from one process to another."""
    note = Note("parts-outside", "2 parts lie outside: R1, R2.", count=2, names="R1, R2")
    for other in (copy.deepcopy(note), pickle.loads(pickle.dumps(note))):
        assert (other, other.code, other.values) == (note, note.code, note.values)
