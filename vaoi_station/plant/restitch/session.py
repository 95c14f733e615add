"""One call of `vaoi restitch`: which runs are left to do, the work on them, and the data set of all."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

from vaoi_station.errors import InputError
from vaoi_station.files.documents import check_format, read_json, write_bytes, write_json
from vaoi_station.plant.archive import RunSelection
from vaoi_station.plant.comparison import Changes, compare, write_changes
from vaoi_station.plant.restitch.task import RunTask, read_outcome, restitch_run
from vaoi_station.plant.restitch.terms import Terms
from vaoi_station.plant.selected_runs import SelectedRuns
from vaoi_station.plant.tables import Tables, write_tables
from vaoi_station.plant.workers import ClusterOptions, Dispatch, cluster_address, dashboard_link

HEAD, TABLES, REPORT, FAULTS = "restitch.json", "tables", "report.html", "left-out.json"
UNEQUAL = "unequal.json"


@dataclass(frozen=True)
class Summary:
    """How a call ended."""

    runs: int
    """Number of selected runs."""
    done: int
    """Number of those that are stitched, by this call or an earlier one."""
    stitched: int
    """Number of runs that this call has stitched."""
    left_out: tuple[str, ...]
    """Runs, archives' faults and workers that were left out, and why."""
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

    Raises:
        InputError: an archive or an option is wrong, or the directory has runs that were stitched with other terms.
        StateError: scheduler or workers do not answer.
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
    write_changes(session.out / REPORT, changes, _terms(session), session.left_out, _unequal(session))
    write_json(session.out / FAULTS, session.left_out)
    write_json(session.out / UNEQUAL, session.unequal)
    return Summary(len(tasks), finished, stitched, tuple(session.left_out), session.unequal, changes)


def _claim(session: Session) -> None:
    """Make the output directory one of these terms, or check that it is."""
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
    """Yield the tables of every stitched run, in the order of the tasks."""
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
    """Return for each reason how many runs were not stitched with all that their station used."""
    return [f"{len(runs)} runs, the first is {runs[0]}: {note}" for note, runs in session.unequal.items()]


def _terms(session: Session) -> list[tuple[str, str]]:
    chosen: dict[str, Any] = {name: value for name, value in vars(session.selection).items() if value is not None}
    made = {name: str(value or "of each run") for name, value in session.terms.document().items()}
    archives = {"archive": ", ".join(session.archives)}
    return [(name.replace("_", " "), str(value)) for name, value in {**archives, **chosen, **made}.items()]
