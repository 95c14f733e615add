from __future__ import annotations

from pathlib import Path

import pytest

from tests.board_data.readers import samples
from vaoi_station.board_data import import_process
from vaoi_station.board_data.import_process import (
    ImportLimits,
    ImportTask,
    import_limited,
    run_import,
)
from vaoi_station.errors import InputError
from vaoi_station.model import BoardType


def test_the_reply_has_board_type_overview_and_picture(tmp_path: Path) -> None:
    file = tmp_path / "b.kicad_pcb"
    file.write_text(samples.KICAD)
    reply = run_import(ImportTask(file=file, name="p"))
    assert reply.overview is not None
    assert reply.overview.name == BoardType.model_validate_json(reply.board_type).name == "p"
    assert reply.picture.startswith("<svg")


@pytest.mark.parametrize("name", ["", "a/b", ".a", "a\\b", "a\n", "n" * 81])
def test_a_given_name_under_which_nothing_can_be_stored_is_refused(tmp_path: Path, name: str) -> None:
    file = tmp_path / "b.kicad_pcb"
    file.write_text(samples.KICAD)
    refusal = run_import(ImportTask(file=file, name=name)).refusal
    assert refusal.startswith("--name: the name is ")
    assert refusal.endswith("1 to 80 characters without slashes, control characters and leading dot.")


def test_an_error_that_no_reader_foresees_is_a_refusal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(import_process, "read_design", fail)
    reply = run_import(ImportTask(file=tmp_path / "b"))
    assert "b: is damaged, or not as its format demands (ZeroDivisionError)." in reply.refusal


def test_a_file_is_imported_in_a_process_of_its_own(tmp_path: Path) -> None:
    file = tmp_path / "b.kicad_pcb"
    file.write_text(samples.KICAD)
    reply = import_limited(ImportTask(file=file))
    assert reply.overview is not None
    assert reply.overview.components == 3


def test_a_file_that_needs_too_much_memory_is_refused(tmp_path: Path) -> None:
    """Of a zip member that inflates a thousand times, the process may not keep more than its limit."""
    file = tmp_path / "bomb.zip"
    file.write_bytes(samples.odb_zip(samples.ODB | {"job/steps/pcb/eda/data": "PKG A 0 0 0 1 1;\n" * 3_000_000}))
    with pytest.raises(InputError, match=r"bomb\.zip: (needs more than|cannot be read within)"):
        import_limited(ImportTask(file=file), ImportLimits(memory_bytes=400 * 2**20))


def test_a_file_that_needs_too_long_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot be read within 0\.01 s; the file is refused"):
        import_limited(ImportTask(file=tmp_path / "x"), ImportLimits(wall_s=0.01))
