"""`vaoi restitch`: archived runs stitched again on a Dask cluster, by the code of the station.

Dask distributes one task per run. What counts as done is on the disk: one file per run, written atomically by the
command. So neither a worker, nor the scheduler, nor the command must live on for its work to remain.
"""

from __future__ import annotations

import gzip
import json
import os
import resource
import time
import uuid
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from hashlib import sha256
from itertools import chain
from pathlib import Path
from typing import Any

from vaoi_station.errors import InputError
from vaoi_station.files import read_board_type, read_stitch
from vaoi_station.files.documents import check_format, read_json, write_bytes, write_json
from vaoi_station.files.results import stitch_document
from vaoi_station.model import ReasonCode, Status, Stitch
from vaoi_station.plant.addition import REFERENCE
from vaoi_station.plant.archive import Archive, RunSelection
from vaoi_station.plant.changes import Changes, compare, render_changes
from vaoi_station.plant.cluster import ClusterOptions, Dispatch, Outcome, cluster_address, dashboard_link, perform
from vaoi_station.plant.manifest import ArchivedRun, StationRecord, read_record
from vaoi_station.plant.selected_runs import SelectedRuns
from vaoi_station.plant.tables import RunKey, Tables, result_tables, write_tables
from vaoi_station.stitching.matching.evidence import METHODS, MethodName
from vaoi_station.stitching.recordings.opening import OpenedRun, open_run
from vaoi_station.stitching.recordings.origin import with_origin
from vaoi_station.stitching.recordings.references import RESULT
from vaoi_station.stitching.work import stitch_frames


@dataclass(frozen=True)
class Terms:
    """With what runs are stitched; None: with what the archive has for each run."""

    software: str
    calibration: bytes | None = None
    board_type: bytes | None = None
    method: MethodName | None = None

    def document(self) -> dict[str, Any]:
        """Return what identifies the terms, as a JSON object."""
        digests = {"calibration": self.calibration, "board_type": self.board_type}
        return {
            "software": self.software,
            "method": self.method,
            **{name: content and sha256(content).hexdigest() for name, content in digests.items()},
        }


def open_archived(folder: Path, scratch: Path, terms: Terms) -> tuple[OpenedRun, list[str]]:
    """Open an extracted run for stitching.

    Returns also, in sentences, why its result may differ from that of its station with equal terms.
    """
    reference = folder / REFERENCE
    calibration = _replaced("calibration.json", terms.calibration, scratch, reference)
    board = _replaced("board.json", terms.board_type, scratch, reference)
    record = read_record(folder)
    made = record.made_with if record else None
    method = terms.method or (made.method if made else "auto")
    notes: list[str] = []
    if record is not None and (made is None or made.terms is None):
        notes.append("Its station did not state where it expected the board, and what of it was to be seen.")

    def opened(placed_against: Path | None) -> OpenedRun:
        stated = made.terms if made else None
        return open_run(
            folder, calibration=calibration, board=board, reference=placed_against, method=method, terms=stated
        )

    if made is None or made.reference is None or not METHODS[method].reference:
        return opened(None), notes
    absent = f"The reference {made.reference}, against which its station placed the board,"
    if not reference.is_dir():
        return opened(None), [*notes, f"{absent} is not in the archive."]
    try:
        return opened(reference), notes
    except InputError as error:
        if method == "reference":
            raise
        # As the station does with a reference that has become unusable.
        return opened(None), [*notes, f"{absent} is not used: {error}"]


def _replaced(name: str, content: bytes | None, scratch: Path, reference: Path) -> Path | None:
    """Write another document as a file, and let it hold for the reference too, whose result is then out of date."""
    if content is None:
        return None
    write_bytes(scratch / name, content, durable=False)
    if reference.is_dir():
        write_bytes(reference / name, content, durable=False)
        (reference / RESULT).unlink(missing_ok=True)
    return scratch / name


FORMAT, VERSION = "vaoi-restitched-run", 1
_OF_RESULTS = frozenset(code.value for code in ReasonCode)
"""Codes of reasons that follow from the pictures of a run: another result finds them again if they hold."""
_NOTES = frozenset({"board-type-draft", "reference-unusable"})
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
    """Stitch one run, and return its file: packed JSON with tables, result and cost."""
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
    """Read the file of a stitched run; InputError if it is damaged, or of a newer version."""
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


HEAD, TABLES, REPORT, FAULTS = "restitch.json", "tables", "report.html", "left-out.json"
UNEQUAL = "unequal.json"


@dataclass(frozen=True)
class Summary:
    """How a call ended."""

    runs: int
    done: int
    stitched: int
    left_out: tuple[str, ...]
    unequal: dict[str, list[str]]
    """Runs that were not stitched with all that their station used, by the reason."""
    changes: Changes


@dataclass
class Session:
    """What a call works on.

    `progress` receives the numbers of done runs and of all, which falls while manifests of runs are read that are not
    selected; `report` receives a sentence on a fault, `inform` any other one.
    """

    archives: list[str]
    selection: RunSelection
    terms: Terms
    out: Path
    progress: Callable[[int, int], None] = lambda _done, _runs: None
    report: Callable[[str], None] = lambda _text: None
    inform: Callable[[str], None] = lambda _text: None
    left_out: list[str] = field(default_factory=list)
    unequal: dict[str, list[str]] = field(default_factory=dict)

    def leave_out(self, text: str) -> None:
        """Note and report what is left out."""
        self.left_out.append(text)
        self.report(text)


def restitch(session: Session, options: ClusterOptions) -> Summary:
    """Stitch all selected runs that are not done yet, then write data set and report.

    After an interruption of any kind the same call goes on where this one ended.
    """
    options.check()
    _claim(session)
    selected = SelectedRuns(session.archives, session.selection, session.leave_out)
    tasks: list[RunTask] = []
    finished = stitched = 0

    def left_to_do() -> Iterator[RunTask]:
        nonlocal finished
        for run in selected:
            task = RunTask(*run, session.terms)
            tasks.append(task)
            if (session.out / task.file).is_file():
                finished += 1
            else:
                yield task

    def keep(task: RunTask, content: bytes) -> None:
        nonlocal finished, stitched
        write_bytes(session.out / task.file, content)
        finished, stitched = finished + 1, stitched + 1
        session.progress(finished, selected.runs)

    def leave_out(_: RunTask, text: str) -> None:
        session.leave_out(text)

    todo = left_to_do()
    first = next(todo, None)
    session.progress(finished, selected.runs)
    if first is not None:
        with cluster_address(options) as address:
            if link := dashboard_link(address, options.patience_s):
                session.inform(f"dashboard: {link}")
            dispatch = Dispatch(session.terms.software, restitch_run, keep, leave_out, session.report)
            dispatch.work(address, chain((first,), todo), selected.archives, options.patience_s)
        session.left_out += dispatch.refused_workers
        session.progress(finished, selected.runs)
    write_tables(session.out / TABLES, _done(session, tasks))
    changes = compare(session.out / TABLES)
    report = render_changes(changes, _terms(session), session.left_out, _unequal(session))
    write_bytes(session.out / REPORT, report.encode())
    write_json(session.out / FAULTS, session.left_out)
    write_json(session.out / UNEQUAL, session.unequal)
    return Summary(len(tasks), finished, stitched, tuple(session.left_out), session.unequal, changes)


def _claim(session: Session) -> None:
    path = session.out / HEAD
    document = {"format": "vaoi-restitch", "version": 1, "terms": session.terms.document()}
    if path.exists():
        found = read_json(path)
        check_format(found, path, "vaoi-restitch", 1)
        theirs = found.get("terms") if isinstance(found.get("terms"), dict) else {}
        for name, value in document["terms"].items():  # type: ignore[attr-defined]
            if theirs.get(name) != value:
                raise InputError(
                    f"{path}: its runs were stitched with the {name} {theirs.get(name)!r}, this call has {value!r}.",
                    action="Repeat the call with what it was begun with, or give another --out.",
                )
        return
    if session.out.exists() and any(session.out.iterdir()):
        raise InputError(
            f"{session.out}: is not empty and has no {HEAD}.", action="Give a new directory, or one of an earlier call."
        )
    write_json(path, document | {"id": uuid.uuid4().hex})


def _done(session: Session, tasks: list[RunTask]) -> Iterator[Tables]:
    for task in tasks:
        path = session.out / task.file
        if not path.is_file():
            continue
        try:
            outcome = read_outcome(path)
        except InputError as error:
            session.leave_out(str(error))
            continue
        for note in outcome["notes"]:
            session.unequal.setdefault(note, []).append(task.key)
        yield outcome["tables"]


def _unequal(session: Session) -> list[str]:
    return [f"{len(runs)} runs, the first is {runs[0]}: {note}" for note, runs in session.unequal.items()]


def _terms(session: Session) -> list[tuple[str, str]]:
    chosen: dict[str, Any] = {name: value for name, value in vars(session.selection).items() if value is not None}
    made = {name: str(value or "of each run") for name, value in session.terms.document().items()}
    archives = {"archive": ", ".join(session.archives)}
    return [(name.replace("_", " "), str(value)) for name, value in {**archives, **chosen, **made}.items()]
