"""Runs are exported and imported."""

from __future__ import annotations

import gzip
import io
import json
import os
import tarfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest

from tests.transfer.conftest import MEASURES, Site
from vaoi_station.config import StationConfig, read_config
from vaoi_station.demo.station_files import to_toml
from vaoi_station.errors import DeviceError, GoneError, InputError, NotFoundError
from vaoi_station.files import open_recording, read_board_type, read_calibration, read_stitch
from vaoi_station.files.directories import remove_directory
from vaoi_station.files.images import encode_tiff
from vaoi_station.model import BoardType, Reason, Status
from vaoi_station.model.board_identity import IdentityDocument
from vaoi_station.parts.learned import TaughtBoard, read_taught_board
from vaoi_station.parts.patches import Grid, ViewClass, kind_of
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.archive.measured_parts import DIRECTORY as GOOD_BOARDS
from vaoi_station.runs.archive.measured_parts import good_file
from vaoi_station.runs.archive.recordings import Recordings
from vaoi_station.runs.states import run_ids
from vaoi_station.runs.states.schemas import RunDetail
from vaoi_station.store import Database, Store
from vaoi_station.store.retention import MOST_PINS
from vaoi_station.transfer import runs
from vaoi_station.transfer.package import open_files, write_package
from vaoi_station.transfer.runs import HEAD_FILE, KIND, export_run, import_into_history, import_run


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
    assert (tmp_path / "out" / "parts.json").read_text() == MEASURES
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
        patch.setattr(runs, "open_files", open_deleted)
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


@dataclass(frozen=True)
class Other:
    """Another station, which has filmed nothing yet."""

    config_path: Path
    config: StationConfig
    store: Store

    def keep(self, **quotas: float) -> None:
        """Write other quotas into its station.toml."""
        keep = self.config.keep.model_copy(update=quotas)
        self.config_path.write_text(to_toml(self.config.model_copy(update={"keep": keep})))

    def recordings(self, archive: Archive) -> Recordings:
        """Return its recordings, as a running station has them."""
        away: Any = None
        return Recordings(self.config.data / "recordings", self.config.keep, archive, EventLog(self.store), away)


@pytest.fixture
def other(site: Site, tmp_path: Path) -> Iterator[Other]:
    folder = tmp_path / "other"
    folder.mkdir()
    path = folder / "station.toml"
    path.write_text(site.config.read_text().replace('name = "test"', 'name = "other"'))
    config = read_config(path)
    store = Store(Database(config.data / "station.db"))
    yield Other(path, config, store)
    store.close()


@pytest.fixture
def exported(site: Site, tmp_path: Path) -> Callable[[str], Path]:
    def export(run: str) -> Path:
        export_run(site.config, run, tmp_path / f"{run}.vaoi")
        return tmp_path / f"{run}.vaoi"

    return export


def rewritten(
    package: Path, leave_out: tuple[str, ...] = (), added: dict[str, bytes] | None = None, **changed: Any
) -> Path:
    """Write a package again without some files, with further ones, and with other content of JSON files."""
    entries = {}
    with tarfile.open(fileobj=io.BytesIO(gzip.decompress(package.read_bytes()))) as tar:
        for member in tar:
            content = tar.extractfile(member)
            assert content is not None
            entries[member.name] = content.read()
    manifest = json.loads(entries.pop("manifest.json"))
    for name, update in changed.items():
        entries[f"{name}.json"] = json.dumps(json.loads(entries[f"{name}.json"]) | update).encode()
    out = package.with_suffix(".changed")
    kept = [(name, content) for name, content in (entries | (added or {})).items() if name not in leave_out]
    write_package(out, KIND, kept, {"station": manifest["station"], "made": manifest["made"]})
    return out


def test_a_run_with_frames_is_part_of_the_history_of_another_station(
    site: Site, other: Other, exported: Callable[[str], Path]
) -> None:
    # A station that runs: its archive was built before the import.
    archive = Archive(other.store, EventLog(other.store))
    recordings = other.recordings(archive)
    imported = import_into_history(exported(site.degraded), other.config_path)
    assert imported.with_frames
    finished, there = archive.get(site.degraded), site.rig.coordinator.run(site.degraded)
    assert finished.detail.frames == there.frames
    assert finished.detail.reasons == there.reasons
    assert finished.text == site.rig.coordinator.stitch_text(site.degraded)
    assert len(finished.cameras) == 2
    assert finished.timeline == site.rig.archive.get(site.degraded).timeline
    [listed] = archive.list(10, None)
    assert listed.origin is not None
    assert (listed.origin.station, listed.state, listed.frames_available) == ("test", "gone", False)
    # The station takes in what a process of another kind has added.
    assert recordings.path_of(site.degraded) is None
    assert not other.store.retention.pinned(site.degraded)
    recordings.tend()
    assert recordings.frame_file(site.degraded, 1, 2) is not None
    assert other.store.retention.pinned(site.degraded)
    assert [path.name for path in other.config.data.glob(".*")] == []


def good_board(board_type: BoardType, name: str) -> TaughtBoard:
    """Return a good board with a grey picture of each part."""
    kinds = sorted({kind_of(part, board_type) for part in board_type.components})
    of_kind = tuple(tuple(p.address for p in board_type.components if kind_of(p, board_type) == k) for k in kinds)
    patches = tuple(np.full((len(some), 1, 4, 4), 9, np.uint8) for some in of_kind)
    heights = tuple(np.full((len(some), 3), np.nan, np.float32) for some in of_kind)
    grids = tuple(Grid(kind, 4, 4, 10.0, (2.0, 2.0)) for kind in kinds)
    return TaughtBoard(name, "parts", "camera", (ViewClass("ring", 100.0),), grids, of_kind, patches, heights)


def test_a_good_board_is_one_of_the_station_that_imports_it(
    site: Site, other: Other, exported: Callable[[str], Path]
) -> None:
    board_type = site.rig.coordinator.board_type("small")
    here, there = (good_file(s.data / GOOD_BOARDS, "small", site.degraded) for s in (site.rig.config, other.config))
    good_board(board_type, site.degraded).write(here)
    package = exported(site.degraded)
    good_board(board_type, "another").write(here)
    for content, said in (
        (b"PK", "changed: good.parts: is no file of a taught board"),
        (here.read_bytes(), "'another'"),
    ):
        wrong = rewritten(package, added={"good.parts": content})
        with pytest.raises(InputError, match=said):
            import_into_history(wrong, other.config_path)
        wrong.unlink()
    outside = rewritten(package, run={"board_type": str(other.config.data.parent / "outside")})
    with pytest.raises(InputError, match="or not of board type"):
        import_into_history(outside, other.config_path)
    assert not (other.config.data.parent / "outside").exists()
    assert not there.exists()
    imported = import_into_history(package, other.config_path)
    assert (imported.good, imported.with_frames) == (True, True)
    assert read_taught_board(there).name == site.degraded
    assert not (other.config.data / "recordings" / site.degraded / "good.parts").exists()


def test_an_imported_run_is_no_board_of_this_line(site: Site, other: Other, exported: Callable[[str], Path]) -> None:
    for run in (site.sound, site.degraded):
        import_into_history(exported(run), other.config_path)
    archive = Archive(other.store, EventLog(other.store))
    assert [archive.store.heights(run) for run in (site.sound, site.degraded)] == ['{"heights":{}}', None]
    assert [archive.store.parts(run) for run in (site.sound, site.degraded)] == [MEASURES, None]
    assert archive.identities.runs_of("SN-1", 9, None) == [site.sound]
    assert '"not-compared"' in (archive.identities.document(site.sound) or "")
    assert archive.latest() is None
    assert archive.next(None, 0) is None
    assert archive.next(site.degraded, 0) is None
    assert [run.id for run in archive.list(10, None)] == [site.degraded, site.sound]
    assert archive._finished == 0


def test_a_run_that_was_forgotten_comes_back(site: Site, exported: Callable[[str], Path]) -> None:
    package, archive = exported(site.sound), site.rig.archive
    with pytest.raises(InputError, match="is in the history of this station already"):
        import_into_history(package, site.config)
    before, number = site.rig.coordinator.stitch_text(site.sound), archive.get(site.sound).finish_number
    archive.retention.forget_details([site.sound]).result(10)
    again = Archive(site.rig.store, EventLog(site.rig.store))
    assert again.list(10, None)[-1].forgotten
    assert not import_into_history(package, site.config).with_frames
    assert (again.get(site.sound).text, again.get(site.sound).finish_number) == (before, number)
    assert not again.list(10, None)[-1].forgotten
    assert site.rig.store.retention.whole() == (1, 1)


def test_frames_need_the_quota_and_nothing_stays_of_a_refusal(
    site: Site, other: Other, exported: Callable[[str], Path]
) -> None:
    package = exported(site.degraded)
    other.keep(recordings_gb=0.0)
    with pytest.raises(DeviceError, match=r"exceed \[keep\] recordings_gb \(0\)"):
        import_into_history(package, other.config_path)
    assert Archive(other.store, EventLog(other.store)).list(10, None) == []
    assert not (other.config.data / "recordings").exists()
    assert [path.name for path in other.config.data.glob(".*")] == []


def test_pictures_that_are_no_frames_of_the_run_are_refused(
    site: Site, other: Other, exported: Callable[[str], Path]
) -> None:
    """The station would decode them in its own process, whatever their size."""
    package = exported(site.degraded)
    with tarfile.open(package) as tar:
        frame = next(name for name in tar.getnames() if name.startswith("frames/"))
    large = encode_tiff(np.zeros((2000, 3000), np.uint8))
    for name, message in ((frame, "is 3000×2000 px, but"), ("frames/cam99_row0.png", "is no frame of")):
        changed = rewritten(package, added={name: large})
        with pytest.raises(InputError, match=message):
            import_into_history(changed, other.config_path)
        changed.unlink()
    assert [path.name for path in other.config.data.glob(".*")] == []


def test_a_small_package_with_a_large_content_does_not_fill_the_disk(
    site: Site, other: Other, exported: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    package = exported(site.sound)
    monkeypatch.setattr("vaoi_station.transfer.runs.DISK_RESERVE", 10**18)
    with pytest.raises(DeviceError, match=r"its next file has 0 MB, but 0 MB .*1e\+09 GB stay"):
        import_into_history(package, other.config_path)
    assert [path.name for path in other.config.data.glob(".*")] == []


def test_runs_that_do_not_fit_the_history_are_refused(
    site: Site, other: Other, exported: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    package = exported(site.sound)
    future = f"{run_ids._text(2**45, 10)}-000000"
    for leave_out, changes, message in (
        ((HEAD_FILE,), {}, "has no head.json"),
        (("board.json",), {}, "has no board.json"),
        ((), {"run": {"id": future}}, "later than this machine's clock"),
        ((), {"run": {"id": "../x"}}, r"run.json: id is '../x'"),
        ((), {"calibration": {"unit": "inch"}}, r"calibration.json"),
        ((), {"board": {"name": "another"}}, r"board.json has the digest \w+, but the run was made with"),
        ((), {"result": {"method": 7}}, r"result.json"),
        ((), {"heights": {"heights": {"U1": {"views": 2, "height_mm": 1}}}}, r"heights.json: heights.U1: has only one"),
        ((), {"heights": {"heights": [1]}}, r"heights.json: heights: .*Export the run again"),
    ):
        changed = rewritten(package, leave_out, **changes)
        with pytest.raises(InputError, match=message):
            import_into_history(changed, other.config_path)
        changed.unlink()
    owner = os.geteuid()
    with monkeypatch.context() as patch:
        patch.setattr(os, "geteuid", lambda: owner + 1)
        with pytest.raises(InputError, match=f"belongs to the user with uid {owner}"):
            import_into_history(package, other.config_path)
    assert Archive(other.store, EventLog(other.store)).list(10, None) == []
    monkeypatch.setattr("vaoi_station.transfer.runs.MOST_PINS", 0)
    assert MOST_PINS > 0
    with pytest.raises(InputError, match="0 runs are pinned, which is the limit"):
        import_into_history(package, other.config_path)
