"""One run: the station's result, and faults as values that name run and blob."""

from __future__ import annotations

import gzip
import json
from dataclasses import replace
from pathlib import Path

import pytest

from tests.plant.conftest import add_runs, outcome_of, task_of
from vaoi_station import RecordedRun, StitchedRun
from vaoi_station.errors import InputError, StateError
from vaoi_station.files.results import stitch_document
from vaoi_station.model import Status
from vaoi_station.plant.archive import Archive
from vaoi_station.plant.archive.station_record import StationRecord
from vaoi_station.plant.restitch.task import _with_verdict, read_outcome, restitch_run, with_lasting_reasons
from vaoi_station.plant.restitch.terms import Terms
from vaoi_station.plant.workers.run_work import RunFault, UnseenArchive
from vaoi_station.plant.workers.software import software


def test_the_result_is_that_of_the_station(stored: Archive, stitched: StitchedRun, tmp_path: Path) -> None:
    document = outcome_of(stored, "r1", tmp_path)
    ours, theirs = json.loads(json.dumps(document["result"])), json.loads(json.dumps(stitch_document(stitched.result)))
    for result in (ours, theirs):
        del result["quality"]["timings_ms"]
        del result["quality"]["recording"]["name"]  # that of the folder
    assert ours == theirs, "to the last digit"
    assert (document["station"], document["run"]) == ("line 1", "r1")
    tables = document["tables"]
    assert isinstance(tables, dict)
    assert tables["runs"]["result"] == ["former", "new"]
    views = tables["views"]["x_px"]
    assert views[: len(views) // 2] == views[len(views) // 2 :]


@pytest.mark.parametrize(
    ("verdict", "statuses", "expected"),
    [("degraded", "ok ok", "degraded degraded"), ("degraded", "ok failed", "degraded failed"),
     ("degraded", "degraded ok", "degraded ok"), (None, "ok ok", "ok ok")],
)  # fmt: skip
def test_verdict_of_the_run_holds_for_both_results(
    stitched: StitchedRun, verdict: str | None, statuses: str, expected: str
) -> None:
    """What degrades a run beside its result, such as another board id, is not mended by another result."""
    former, new = (stitched.result.model_copy(update={"status": Status(s)}) for s in statuses.split())
    found = _with_verdict(Status(verdict) if verdict else None, former, new)
    assert " ".join(result.status for result in found) == expected


def test_reasons_that_another_result_does_not_mend_keep_a_run_degraded(stitched: StitchedRun) -> None:
    """Two boards in one run, or another board than was armed, are no matter of the pictures."""
    sound = stitched.result
    former = sound.model_copy(
        update={
            "status": Status.DEGRADED,
            "reasons": ("blank", "2 boards passed in this run"),
            "reason_codes": ("overlap-blank", "boards-too-close"),
        }
    )
    found = with_lasting_reasons(None, former, sound)
    assert (found.status, found.reason_codes, found.reasons) == (
        Status.DEGRADED,
        ("boards-too-close",),
        ("2 boards passed in this run",),
    )
    reasons = [
        {"code": code, "message": code}
        for code in ("stitch-degraded", "frames-missing", "board-id-differs", "board-type-draft")
    ]
    record = StationRecord.model_validate(
        {"id": "r", "started": "2026-11-27T10:00:00Z", "verdict": "degraded", "reasons": reasons}
    )
    assert with_lasting_reasons(record, None, sound).reason_codes == ("board-id-differs",)
    assert with_lasting_reasons(record.model_copy(update={"verdict": Status.OK}), None, sound) is sound
    failed = sound.model_copy(update={"status": Status.FAILED})
    assert with_lasting_reasons(record, former, failed).status is Status.FAILED
    assert with_lasting_reasons(None, None, sound) is sound


def test_another_calibration_is_used(stored: Archive, moved_calibration: Path, tmp_path: Path) -> None:
    document = outcome_of(stored, "r0", tmp_path, Terms(software(), calibration=moved_calibration.read_bytes()))
    tables = document["tables"]
    assert isinstance(tables, dict)
    moved = tables["cameras"]["y_px"]
    assert moved[4] - moved[1] == pytest.approx(-0.2, abs=0.03)


def test_another_board_type_holds_for_the_new_result_only(stored: Archive, board: RecordedRun, tmp_path: Path) -> None:
    document = json.loads((board.directory / "board.json").read_text(encoding="utf-8"))
    first, second, *others = document["components"]
    moved = first | {"center": [first["center"][0] + 1.0, first["center"][1]]}
    changed = json.dumps(document | {"components": [moved, *others]}).encode()
    tables = outcome_of(stored, "r0", tmp_path, Terms(software(), board_type=changed))["tables"]
    parts = tables["components"]
    x_mm = {(r, c): x for r, c, x in zip(parts["result"], parts["component"], parts["x_mm"], strict=True)}
    assert ("former", second["ref"]) in x_mm
    assert ("new", second["ref"]) not in x_mm
    assert abs(x_mm["new", first["ref"]] - x_mm["former", first["ref"]]) == pytest.approx(1.0, abs=0.01)


def test_a_board_type_that_fits_nothing_is_a_fault(stored: Archive) -> None:
    terms = Terms(software(), board_type=b'{"name": "bare"}')
    fault = restitch_run(task_of(stored, "r0", terms))
    assert isinstance(fault, RunFault)


def test_a_missing_and_a_damaged_blob_are_named(board: RecordedRun, tmp_path: Path) -> None:
    archive = Archive.create(tmp_path / "archive")
    add_runs(archive, board.directory, 1)
    run = archive.run("r0")
    blob = run.frames[3]
    path = tmp_path / "archive" / blob.key
    content = path.read_bytes()
    path.write_bytes(content[:100] + bytes([content[100] ^ 1]) + content[101:])
    task = task_of(archive, "r0")
    assert "r0" in str(restitch_run(task))
    assert blob.sha256 in str(restitch_run(task))
    path.unlink()
    assert "is missing" in str(restitch_run(task))


def test_an_archive_that_is_not_seen_is_no_fault_of_the_run(board: RecordedRun, tmp_path: Path) -> None:
    archive = Archive.create(tmp_path / "archive")
    add_runs(archive, board.directory, 1)
    task = task_of(archive, "r0")
    assert isinstance(restitch_run(task), bytes)
    (tmp_path / "archive").rename(tmp_path / "elsewhere")
    unseen = restitch_run(task)
    assert isinstance(unseen, UnseenArchive)
    assert "is no archive" in unseen.message
    (tmp_path / "elsewhere").rename(tmp_path / "archive")
    assert isinstance(restitch_run(task), bytes)


def test_a_run_that_was_replaced_after_its_selection_is_a_fault(stored: Archive) -> None:
    fault = restitch_run(replace(task_of(stored, "r0"), manifest="0" * 16))
    assert isinstance(fault, RunFault)
    assert "was replaced after the run was selected" in fault.message


def test_other_software_is_refused(stored: Archive) -> None:
    task = task_of(stored, "r0", Terms("vaoi_station 0.0.1"))
    with pytest.raises(StateError, match=r"must have vaoi_station 0\.0\.1"):
        restitch_run(task)


FLIPPED = gzip.compress(bytes(range(256)) * 9, mtime=0)
FLIPPED = FLIPPED[:10] + bytes([FLIPPED[10] ^ 0b110]) + FLIPPED[11:]
"""The bits say that the block is of a type that there is not."""


@pytest.mark.parametrize(
    "content",
    [b"", FLIPPED, gzip.compress(b"{"), gzip.compress(b"[]"), gzip.compress(b'{"format": "vaoi-restitched-run"}')],
    ids=["empty", "a flipped bit", "no JSON", "no object", "no version"],
)
def test_a_damaged_file_is_refused_with_what_to_do(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "r.json.gz").write_bytes(content)
    with pytest.raises(InputError, match=r"r\.json\.gz: .* Delete it and repeat"):
        read_outcome(tmp_path / "r.json.gz")
