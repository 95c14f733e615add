"""The work on one run, as a worker performs it: extract, stitch, lay out as tables."""

from __future__ import annotations

import gzip
import json
import os
import resource
import tempfile
import time
import zlib
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vaoi_station.errors import DeviceError, InputError, NotFoundError, StateError
from vaoi_station.files import read_board_type, read_stitch
from vaoi_station.files.results import stitch_document
from vaoi_station.model import Status, Stitch
from vaoi_station.plant.archive import Archive
from vaoi_station.plant.archive.catalogue import read_manifest
from vaoi_station.plant.archive.manifest import ArchivedRun
from vaoi_station.plant.restitch.opening import open_archived
from vaoi_station.plant.restitch.software import software
from vaoi_station.plant.restitch.terms import Terms
from vaoi_station.plant.tables import RunKey, Tables, result_tables
from vaoi_station.stitching.recordings.offline import stitch_frames
from vaoi_station.stitching.recordings.opening import OpenedRun
from vaoi_station.stitching.recordings.origin import with_origin

FORMAT, VERSION = "vaoi-restitched-run", 1


@dataclass(frozen=True)
class RunTask:
    """One run to be stitched: archive, key and digest of its manifest. It is sent to a worker."""

    archive: str
    key: str
    manifest: str
    terms: Terms

    @property
    def file(self) -> str:
        """Place of its outcome: that of another run under its id, or of its former manifest, has another name."""
        return f"{self.key.removesuffix('.json')}-{self.manifest}.json.gz"


@dataclass(frozen=True)
class RunFault:
    """A run that no worker can stitch."""

    message: str


@dataclass(frozen=True)
class UnseenArchive:
    """A worker that does not see the archive of a run: another one may."""

    message: str
    worker: str
    """Address of the worker; empty outside of one."""


def restitch_run(task: RunTask) -> bytes | RunFault | UnseenArchive:
    """Stitch one run, and return its file: packed JSON with tables, result and cost.

    Raises:
        StateError: this process has another software than the terms state.
        DeviceError: storage or disk do not answer. Another attempt may succeed.
    """
    if software() != task.terms.software:
        raise StateError(f"This worker has {software()}, but must have {task.terms.software}.")
    try:
        if task.archive not in _OPENED:
            _OPENED[task.archive] = Archive.open(task.archive)
        return _restitch(_OPENED[task.archive], task)
    except (InputError, NotFoundError) as error:
        # A value, not an exception: Dask would repeat the task, with the same outcome.
        return _unseen(task.archive) or RunFault(str(error))
    except DeviceError:
        _OPENED.pop(task.archive, None)
        raise


_OPENED: dict[str, Archive] = {}
"""The archives that this process has opened: to open an object store takes almost as long as to stitch a run."""


def _unseen(url: str) -> UnseenArchive | None:
    """Return whether it is the archive that this process does not see, for example because a share is not mounted."""
    try:
        Archive.open(url)
    except InputError as error:
        _OPENED.pop(url, None)
        return UnseenArchive(str(error), _worker("address") or "")
    return None


def _restitch(archive: Archive, task: RunTask) -> bytes:
    began_s, began_cpu_s = time.monotonic(), time.process_time()
    run = read_manifest(archive.storage, task.key)
    if run.digest != task.manifest:
        raise InputError(
            f"{archive.url}/{task.key}: was replaced after the run was selected.", action="Repeat the command."
        )
    with tempfile.TemporaryDirectory(prefix="run-", dir=_worker("local_directory")) as scratch:
        folder = archive.extract(run, Path(scratch) / "run")
        extracted_s = time.monotonic()
        opened, notes = open_archived(folder, Path(scratch), task.terms)
        reference = opened.reference.recording.frame if opened.reference else None
        result = stitch_frames(opened.setup, opened.recording.head, opened.recording.frame, reference)
        result = with_origin(result, opened.recording, opened.calibration, opened.setup.board_type)
        path = folder / "result.json"
        former = read_stitch(path) if path.is_file() else None
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
    if former is not None:
        former, result = _with_verdict(run.verdict, former, result)
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


def _worker(name: str) -> str | None:
    """Return the address or the directory of this worker; Dask removes the directory also after a kill.

    Outside of a worker there is neither.
    """
    from distributed import get_worker

    with suppress(ValueError):
        return str(getattr(get_worker(), name))
    return None
