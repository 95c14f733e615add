"""A run as one file, and back."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import IO

import pytest

from tests.transfer.conftest import Site
from vaoi_station.errors import GoneError, InputError, NotFoundError
from vaoi_station.files import open_recording, read_board_type, read_calibration, read_stitch
from vaoi_station.files.directories import remove_directory
from vaoi_station.model import Reason, Status
from vaoi_station.model.board_identity import IdentityDocument
from vaoi_station.runs.states.schemas import RunDetail
from vaoi_station.transfer import run_export
from vaoi_station.transfer.live_directories import open_files
from vaoi_station.transfer.run_export import export_run, import_run


def test_a_run_with_its_frames_is_a_recording_elsewhere(site: Site, tmp_path: Path) -> None:
    assert export_run(site.config, site.degraded, tmp_path / "run.vaoi")
    detail = import_run(tmp_path / "run.vaoi", tmp_path / "out")
    assert detail.id == site.degraded
    assert open_recording(tmp_path / "out").head.rows == detail.rows
    assert read_stitch(tmp_path / "out" / "result.json").status is Status.DEGRADED
    assert RunDetail.model_validate_json((tmp_path / "out" / "run.json").read_text()) == detail
    assert detail.made_with is not None
    assert (tmp_path / "out" / "configuration.json").read_text() == '{"name": "test"}'
    assert (tmp_path / "out" / "timeline.json").is_file()


def test_a_run_without_frames_has_result_calibration_and_board_type(site: Site, tmp_path: Path) -> None:
    assert not export_run(site.config, site.sound, tmp_path / "run.vaoi")
    import_run(tmp_path / "run.vaoi", tmp_path / "out")
    assert not (tmp_path / "out" / "recording.json").exists()
    assert read_stitch(tmp_path / "out" / "result.json").status is Status.OK
    assert (tmp_path / "out" / "heights.json").read_text() == '{"heights":{}}'
    assert read_board_type(tmp_path / "out" / "board.json").name == "small"
    assert len(read_calibration(tmp_path / "out" / "calibration.json").camera_matrices) == 2


def test_an_exported_run_has_the_verdict_that_its_identity_leaves(site: Site, tmp_path: Path) -> None:
    reason = Reason(code="board-id-differs", message="The next machine has read B2.")
    identity = IdentityDocument(state="differs", board_id="B1", required=True, reasons=(reason,))
    site.rig.coordinator._parts.archive.identify(site.sound, identity).result(10)
    export_run(site.config, site.sound, tmp_path / "run.vaoi")
    detail = import_run(tmp_path / "run.vaoi", tmp_path / "out")
    assert (detail.verdict, [one.code for one in detail.reasons]) == (Status.DEGRADED, ["board-id-differs"])
    assert detail.identity is not None
    assert detail.identity.state == "differs"


def open_deleted(path: Path) -> Iterator[tuple[str, IO[bytes]]]:
    """Stand in for `open_files` while the station deletes the directory."""
    remove_directory(path)
    return open_files(path)


def test_frames_that_are_deleted_meanwhile_end_the_export(site: Site, tmp_path: Path) -> None:
    recording = site.rig.config.data / "recordings" / site.degraded
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_export, "open_files", open_deleted)
        with pytest.raises(GoneError, match=f"{site.degraded}: was deleted while"):
            export_run(site.config, site.degraded, tmp_path / "run.vaoi")
    assert not (tmp_path / "run.vaoi").exists()
    assert not recording.exists()
    assert not export_run(site.config, site.degraded, tmp_path / "run.vaoi"), "without frames"


def test_runs_that_cannot_be_exported_are_refused(site: Site, tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match="no run 'x'"):
        export_run(site.config, "x", tmp_path / "run.vaoi")
    site.rig.coordinator._parts.archive.retention.forget_details([site.sound]).result(10)
    with pytest.raises(GoneError) as refusal:
        export_run(site.config, site.sound, tmp_path / "run.vaoi")
    assert refusal.value.code == "run-forgotten"
    assert not (tmp_path / "run.vaoi").exists()
    export_run(site.config, site.degraded, tmp_path / "run.vaoi")
    with pytest.raises(InputError, match="exists already"):
        import_run(tmp_path / "run.vaoi", tmp_path)
