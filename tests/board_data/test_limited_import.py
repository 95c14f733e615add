from __future__ import annotations

from pathlib import Path

import pytest

from tests.board_data.readers import samples
from vaoi_station.board_data.import_process import ImportLimits, ImportTask
from vaoi_station.board_data.limited_import import import_limited
from vaoi_station.errors import InputError


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
