"""A task is performed on one run of an archive; what another attempt cannot change is a value."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.plant.conftest import task_of
from vaoi_station.errors import DeviceError, InputError, StateError
from vaoi_station.plant.archive import Archive
from vaoi_station.plant.archive.manifest import ArchivedRun
from vaoi_station.plant.workers.run_work import RunFault, UnseenArchive, perform


def test_work_gets_archive_run_and_a_directory_that_goes(stored: Archive) -> None:
    seen: list[Path] = []

    def work(archive: Archive, run: ArchivedRun, scratch: Path) -> bytes:
        assert not list(scratch.iterdir())
        seen.append(scratch)
        return f"{archive.url} {run.run}".encode()

    assert perform(task_of(stored, "r2"), work) == f"{stored.url} r2".encode()
    assert not seen[0].exists()


@pytest.mark.parametrize("kind", [InputError, StateError])
def test_a_fault_of_the_run_is_returned(stored: Archive, kind: type[InputError | StateError]) -> None:
    def work(*_: object) -> bytes:
        raise kind("it does not fit.")

    outcome = perform(task_of(stored, "r2"), work)
    assert isinstance(outcome, RunFault)
    assert "it does not fit." in outcome.message


def test_a_fault_of_the_storage_is_raised_so_that_it_is_tried_again(stored: Archive) -> None:
    def work(*_: object) -> bytes:
        raise DeviceError("it does not answer.")

    with pytest.raises(DeviceError, match="does not answer"):
        perform(task_of(stored, "r2"), work)


def test_an_archive_that_goes_during_the_work_is_no_fault_of_the_run(stored: Archive, tmp_path: Path) -> None:
    (tmp_path / "share").symlink_to(stored.url)
    moved = Archive.open(tmp_path / "share")

    def work(*_: object) -> bytes:
        (tmp_path / "share").unlink()
        raise InputError("a blob is absent.")

    outcome = perform(task_of(moved, "r2"), work)
    assert isinstance(outcome, UnseenArchive)
    assert "is no archive" in outcome.message
