"""Steps of runs and faults of the storage in every order: each later start accepts what it finds."""

from __future__ import annotations

import os
import shutil
import sqlite3
import tempfile
from pathlib import Path
from typing import Any

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from tests.needs import LONG
from tests.runs.conftest import a_board_type, a_calibration, a_config, a_head, a_stitch
from vaoi_station.acquisition.process.messages import RunStarted
from vaoi_station.files.results import stitch_text, without_components
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.run.memory import Bay
from vaoi_station.runs.run.order import OrderFactory
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.run.reference_store import ReferenceStore
from vaoi_station.runs.states.run_ids import RunIds
from vaoi_station.runs.states.tables import RUN, RunState, RunStep
from vaoi_station.runs.workers.jobs import Concluded
from vaoi_station.store import Database, Store

WAIT_S = 30.0


class EveryStart(RuleBasedStateMachine):
    """The archive of a station, over restarts, kills and faults of its disk."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp(prefix="every-start-"))
        self.generation = 0
        self.safe: dict[str, int] = {}
        """Finish numbers of the runs that were announced as stored."""
        self.full = False
        (self.folder / "0" / "data").mkdir(parents=True)
        self.open()

    def open(self) -> None:
        """Start in the folder of the present generation, as `Station.start` does."""
        here = self.folder / str(self.generation)
        self.config = a_config(here)
        self.store = Store(Database(self.config.data / "station.db"))
        events = EventLog(self.store)
        self.archive = Archive(self.store, events)
        self.archive.on_announced = lambda _run, _until_s: None
        self.ids = RunIds(self.store.newest_run())
        calibration, heads = a_calibration(), self.config.heads
        references = ReferenceStore(self.config.data / "references", self.store, calibration.cameras(heads))
        references.sweep()
        factory = OrderFactory(self.config, calibration, self.store, references)
        self.order = factory(a_board_type(), None, None)
        self.active: list[Progress] = []
        self.finished: list[str] = []
        self.full = False
        assert self.store.unfinished() == []
        if self.store.database.notices:
            self.safe.clear()  # a notice says that the history was lost
        for run, number in self.safe.items():
            row = self.store.run(run)
            assert row is not None, f"{run} was announced as stored"
            assert (row.finish_number, row.state) in {(number, "gone"), (number, "released")}

    @rule()
    def begin(self) -> None:
        run = self.ids.next()
        progress = Progress.begin(RunStarted(run, 1, 50.0), Bay(1, "filming", run, 7), self.order)
        self.active.append(progress)
        self.archive.begin(progress)

    @precondition(lambda self: self.active)
    @rule(stitched=st.booleans())
    def finish(self, stitched: bool) -> None:
        progress = self.active.pop(0)
        progress.advance(RunStep.FILMED)
        if stitched:
            stitch = a_stitch(a_head(3))
            progress.result = Concluded(without_components(stitch), stitch_text(stitch))
        progress.advance(RunStep.STITCHED if stitched else RunStep.NOT_STITCHED)
        self.archive.finish(progress)
        self.finished.append(progress.run)

    @precondition(lambda self: self.finished)
    @rule(data=st.data(), step=st.sampled_from([RunStep.RELEASE, RunStep.MEMORY_TAKEN]))
    def take_memory(self, data: st.DataObject, step: RunStep) -> None:
        run = data.draw(st.sampled_from(self.finished))
        if RUN.allows(self.archive.get(run).detail.state, step):
            self.archive.mark(run, step)

    @rule()
    def fill_the_disk(self) -> None:
        if not self.full:
            self.flush()
            self.store.database.write(lambda c: c.execute("PRAGMA max_page_count = 1").fetchall()).result(WAIT_S)
            self.full = True

    @rule()
    def make_room(self) -> None:
        if self.full:
            writer = self.store.database._writer
            assert writer is not None
            writer.execute("PRAGMA max_page_count = 1000000").fetchall()
            self.full = False
            self.flush()

    @rule()
    def tick(self) -> None:
        self.archive.tick()

    @rule(companions=st.booleans())
    def delete_the_file(self, companions: bool) -> None:
        # Before: what opens the file again does not know the limit that stands for a full disk, and its thread closes
        # the connection. SQLite's module for Python ends the process if a connection is closed while it is used.
        self.make_room()
        path = self.config.data / "station.db"
        path.unlink(missing_ok=True)
        if companions:
            path.with_name("station.db-wal").unlink(missing_ok=True)
        self.flush()

    @rule(clean=st.booleans(), data=st.data())
    def restart(self, clean: bool, data: st.DataObject) -> None:
        """Stop or kill the station, perhaps damage what it left, and start it again."""
        if not self.full:
            self.flush()
            self.note_stored()
        before = self.config.data
        if clean:
            self.store.close()
            self.note_stored()
        self.generation += 1
        after = self.folder / str(self.generation)
        after.mkdir()
        shutil.copytree(before, after / "data")
        if not clean:
            self.store.close()
        self.damage(after / "data" / "station.db", data.draw(st.sampled_from(FAULTS)))
        self.open()

    def damage(self, path: Path, fault: str) -> None:
        if fault in ("cut", "garbled", "deleted", "empty"):
            self.safe.clear()
            for ending in ("-wal", "-shm"):
                path.with_name(path.name + ending).unlink(missing_ok=True)
        match fault:
            case "cut":
                os.truncate(path, path.stat().st_size // 2)
            case "garbled":
                path.write_bytes(b"\xa5" * path.stat().st_size)
            case "deleted":
                path.unlink()
            case "empty":
                path.write_bytes(b"")
            case "odd states":
                # What an earlier version, or a lost write, may leave.
                connection = sqlite3.connect(path)
                for state in (*RunState, "of a later version"):
                    connection.execute(
                        """UPDATE runs SET state = ? WHERE id = (SELECT id FROM runs WHERE finish_number IS NULL
                           ORDER BY random() LIMIT 1)""",
                        (state,),
                    )
                connection.execute("UPDATE runs SET detail = '{' WHERE finish_number IS NULL AND random() > 0")
                connection.commit()
                connection.close()

    def flush(self) -> None:
        """Wait until everything is on disk."""
        self.store.database.write(lambda _: None, patient=True).result(WAIT_S)

    def note_stored(self) -> None:
        for run in self.finished:
            finished = self.archive.get(run)
            if finished.detail.stored:
                self.safe[run] = finished.finish_number

    @invariant()
    def every_run_can_be_listed_and_followed(self) -> None:
        listed = [run.id for run in self.archive.list(1000, None)]
        assert listed == sorted(set(listed), reverse=True)
        assert set(self.finished) <= set(listed)
        for run in self.finished:
            self.archive.get(run)
        numbers = [self.archive.get(run).finish_number for run in self.finished]
        assert numbers == sorted(set(numbers))

    def teardown(self) -> None:
        self.store.close()
        shutil.rmtree(self.folder)


FAULTS = ("none", "none", "none", "odd states", "cut", "garbled", "deleted", "empty")
TestEveryStart: Any = EveryStart.TestCase
TestEveryStart.settings = settings(max_examples=60 if LONG else 12, stateful_step_count=25, deadline=None)
