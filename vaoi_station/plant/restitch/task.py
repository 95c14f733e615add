"""The work on one run, as a worker performs it: extract, stitch, lay out as tables."""

from __future__ import annotations

import gzip
import json
import os
import resource
import time
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vaoi_station.errors import InputError
from vaoi_station.files import read_board_type, read_stitch
from vaoi_station.files.results import stitch_document
from vaoi_station.model import ReasonCode, Status, Stitch
from vaoi_station.plant.archive import Archive
from vaoi_station.plant.archive.manifest import ArchivedRun
from vaoi_station.plant.archive.station_record import StationRecord, read_record
from vaoi_station.plant.restitch.opening import open_archived
from vaoi_station.plant.restitch.terms import Terms
from vaoi_station.plant.tables import RunKey, Tables, result_tables
from vaoi_station.plant.workers.run_work import Outcome, perform
from vaoi_station.stitching.recordings.opening import OpenedRun
from vaoi_station.stitching.recordings.origin import with_origin
from vaoi_station.stitching.work import stitch_frames

FORMAT, VERSION = "vaoi-restitched-run", 1
_OF_RESULTS = frozenset(code.value for code in ReasonCode)
"""Codes of reasons that follow from the pictures of a run: another result finds them again if they hold."""
_NOTES = frozenset({"board-type-draft", "reference-unusable"})
"""Codes of remarks, which degrade no run."""
_REPEATED = ("stitch-", "trigger-", "frames-")
"""Beginnings of the codes of reasons in the record of a run that another stitch of its recording finds again."""


@dataclass(frozen=True)
class RunTask:
    """One run to be stitched: archive, key and digest of its manifest. It is sent to a worker."""

    archive: str
    key: str
    manifest: str
    terms: Terms

    @property
    def software(self) -> str:
        """Software that the worker must have."""
        return self.terms.software

    @property
    def file(self) -> str:
        """Place of its outcome: that of another run under its id, or of its former manifest, has another name."""
        return f"{self.key.removesuffix('.json')}-{self.manifest}.json.gz"


def restitch_run(task: RunTask) -> Outcome:
    """Stitch one run, and return its file: packed JSON with tables, result and cost.

    Raises:
        StateError: this process has another software than the terms state.
        DeviceError: storage or disk do not answer. Another attempt may succeed.
    """
    return perform(task, lambda archive, run, scratch: _restitch(archive, run, scratch, task.terms))


def _restitch(archive: Archive, run: ArchivedRun, scratch: Path, terms: Terms) -> bytes:
    began_s, began_cpu_s = time.monotonic(), time.process_time()
    folder = archive.extract(run, scratch / "run")
    extracted_s = time.monotonic()
    opened, notes = open_archived(folder, scratch, terms)
    reference = opened.reference.recording.frame if opened.reference else None
    result = stitch_frames(opened.setup, opened.recording.head, opened.recording.frame, reference)
    result = with_origin(result, opened.recording, opened.calibration, opened.setup.board_type)
    path = folder / "result.json"
    former = read_stitch(path) if path.is_file() else None
    if former is not None:
        former, result = _with_verdict(run.verdict, former, result)
    result = with_lasting_reasons(read_record(folder), former, result)
    tables = _tables(run, former, result, opened)
    cost = {
        "extract_s": round(extracted_s - began_s, 4),
        "stitch_s": round(time.monotonic() - extracted_s, 4),
        "cpu_s": round(time.process_time() - began_cpu_s, 4),
        "rss_mb": round(int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6, 1),
        "process": os.getpid(),
    }
    document = {"format": FORMAT, "version": VERSION, "run": run.run, "station": run.station, "time": run.time}
    document |= {"tables": tables, "result": stitch_document(result), "notes": notes, "cost": cost}
    text = json.dumps(document, allow_nan=False, separators=(",", ":"))
    return gzip.compress(text.encode(), compresslevel=1, mtime=0)


def read_outcome(path: Path) -> dict[str, Any]:
    """Read the file of a stitched run.

    Raises:
        InputError: it is damaged, or of a newer version.
    """
    action = "Delete it and repeat the command: the run is stitched again."
    try:
        document = json.loads(gzip.decompress(path.read_bytes()))
    except (OSError, EOFError, ValueError, zlib.error) as error:
        raise InputError(f"{path}: cannot be read ({error}).", action=action) from error
    found = (document.get("format"), document.get("version")) if isinstance(document, dict) else None
    if found != (FORMAT, VERSION):
        raise InputError(f"{path}: has format and version {found}, must be {(FORMAT, VERSION)}.", action=action)
    return dict(document)


def _tables(run: ArchivedRun, former: Stitch | None, result: Stitch, opened: OpenedRun) -> Tables:
    """Return the rows of both results; those of the former one come first."""
    key = RunKey(run.station, run.run, run.time, run.board_type, run.serial)
    head = opened.recording.head
    tables = result_tables(key, "new", result, opened.setup.board_type, head)
    if former is None:
        return tables
    # The components of the former result are those of the board type with which it was made.
    own = read_board_type(opened.recording.directory / "board.json")
    earlier = result_tables(key, "former", former, own, head)
    return {name: {c: earlier[name][c] + values for c, values in table.items()} for name, table in tables.items()}


def _with_verdict(verdict: Status | None, former: Stitch, result: Stitch) -> tuple[Stitch, Stitch]:
    """Return both results with the verdict of the run, which may be lower than that of the station's result.

    A board id that differs, for example, is no fault of the result: it holds for the new result too.
    """
    order = list(Status)
    if verdict is None or order.index(verdict) <= order.index(former.status):
        return former, result
    lowered = max(verdict, result.status, key=order.index)
    return former.model_copy(update={"status": verdict}), result.model_copy(update={"status": lowered})


def with_lasting_reasons(record: StationRecord | None, former: Stitch | None, result: Stitch) -> Stitch:
    """Return a result with those reasons of the run that another result does not mend: it is degraded by them.

    These are faults of the run, such as several boards in it, and an identity that differs. The station writes them
    into the record of the run, and into its result.
    """
    found: dict[str, str] = {}
    if former is not None and former.reason_codes:
        found |= dict(zip(former.reason_codes, former.reasons, strict=True))
    if record is not None and record.verdict not in (None, Status.OK):
        found |= {reason.code: reason.message for reason in record.reasons}
    lasting = {
        code: text
        for code, text in found.items()
        if code and code not in _OF_RESULTS | _NOTES and not code.startswith(_REPEATED)
    }
    if not lasting:
        return result
    codes = result.reason_codes or ("",) * len(result.reasons)
    return result.model_copy(
        update={
            "status": Status.DEGRADED if result.status is Status.OK else result.status,
            "reasons": (*result.reasons, *lasting.values()),
            "reason_codes": (*codes, *lasting),
        }
    )
