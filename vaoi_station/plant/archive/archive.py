"""An archive: open, add, list, extract, verify, prune."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from vaoi_station.errors import InputError, NotFoundError, VaoiError
from vaoi_station.files.documents import check_format
from vaoi_station.plant.archive import addition, catalogue, extraction, pruning, verification
from vaoi_station.plant.archive.fault import ArchiveFault, OnFault, ignore_fault
from vaoi_station.plant.archive.manifest import ArchivedRun, RunLabel
from vaoi_station.plant.archive.object_storage import FsspecStorage
from vaoi_station.plant.archive.pruning import GRACE_S, Pruned
from vaoi_station.plant.archive.selection import RunSelection
from vaoi_station.plant.archive.storage import LocalStorage, Storage
from vaoi_station.plant.archive.verification import Verified

MARKER = "archive.json"
VERSION = 1
ALL_RUNS, AS_RECORDED = RunSelection(), RunLabel()


class Archive:
    """Finished runs of any number of stations. Any number of processes may read and write it at the same time."""

    def __init__(self, storage: Storage) -> None:
        self.storage = storage

    @property
    def url(self) -> str:
        """Path or address of the archive."""
        return self.storage.url

    @classmethod
    def create(cls, url: str | Path) -> Archive:
        """Make a new archive; an archive that is there already is opened.

        Raises:
            InputError: the path has other things, or the archive is newer than the software.
        """
        storage = _storage(url)
        if storage.entry(MARKER) is None:
            if storage.names(""):
                raise InputError(
                    f"{storage.url}: is not empty and no archive.", action="Give an empty or absent directory."
                )
            storage.write(MARKER, (json.dumps({"format": "vaoi-archive", "version": VERSION}) + "\n").encode())
        return cls.open(url)

    @classmethod
    def open(cls, url: str | Path) -> Archive:
        """Open an archive: a path, or an address that fsspec understands.

        Raises:
            InputError: there is no archive, or it is newer than the software.
            DeviceError: the storage does not answer.
        """
        storage = _storage(url)
        try:
            data = catalogue.read_document(storage, MARKER)
        except NotFoundError as error:
            raise InputError(
                f"{storage.url}: is no archive: it has no {MARKER}.",
                action="Check the path and that the share is mounted; `vaoi archive create` makes a new archive.",
            ) from error
        check_format(data, Path(f"{storage.url}/{MARKER}"), "vaoi-archive", VERSION)
        return cls(storage)

    def add(
        self,
        recording: Path,
        *,
        result: Path | None = None,
        calibration: Path | None = None,
        board_type: Path | None = None,
        light_program: Path | None = None,
        station: str = "unnamed",
        label: RunLabel = AS_RECORDED,
    ) -> ArchivedRun:
        """Store a recording with its documents, and return the run as the archive has it.

        What the archive has already is not written again. Of a run that it has with a worse verdict nothing changes.

        Documents that are not given are `result.json`, `calibration.json`, `board.json` and `light_program.json` of the
        recording. Without calibration or board type the recording is refused; the others may be absent. The reference
        against which a station placed the board is taken from `reference` in the recording, or from the station's
        references, if the recording is among the station's.

        Raises:
            InputError: the recording or a document is invalid, or the archive has another run under this id.
            DeviceError: the storage takes no writes or does not answer. A later call goes on where this one ended.
        """
        given = addition.Documents(result, calibration, board_type, light_program)
        return addition.add(self.storage, recording, given, station, label)

    def runs(self, selection: RunSelection = ALL_RUNS, on_fault: OnFault = ignore_fault) -> Iterator[ArchivedRun]:
        """Yield the selected runs by station, day and id. Manifests that cannot be used are left out and reported.

        Of two runs with one id neither is yielded: which of them is meant is not known.
        """
        return catalogue.runs(self.storage, selection, on_fault)

    def run(self, run: str) -> ArchivedRun:
        """Return the run with an id; InputError if several have it, NotFoundError if none has."""
        found = [place for place in catalogue.places(self.storage) if place.run == run]
        if not found:
            raise NotFoundError(f"{self.url}: has no run {run!r}.", action="See `vaoi archive list`.")
        if len(found) > 1:
            raise catalogue.several(self.storage, found)
        return catalogue.read_manifest(self.storage, found[0].key)

    def extract(self, run: ArchivedRun | str, folder: Path) -> Path:
        """Write a run to a new folder as the station would read it, and return the folder.

        It has `recording.json`, frames, `calibration.json`, `board.json`, and `result.json`, `light_program.json`,
        `run.json` and `reference` where the archive has them.

        Raises:
            InputError: the folder exists, or a blob is damaged.
            NotFoundError: there is no such run, or a blob is missing.
        """
        return extraction.extract(self.storage, self.run(run) if isinstance(run, str) else run, folder)

    def restore(
        self, folder: Path, selection: RunSelection = ALL_RUNS, on_fault: OnFault = ignore_fault
    ) -> Iterator[ArchivedRun]:
        """Extract the selected runs to folders of their ids below `folder`, and yield each that is there.

        A run whose folder exists is not extracted again: an interrupted call goes on where it ended.
        """
        for run in self.runs(selection, on_fault):
            try:
                if not (folder / run.run).exists():
                    self.extract(run, folder / run.run)
            except VaoiError as error:
                on_fault(ArchiveFault.of(error))
            else:
                yield run

    def verify(self, selection: RunSelection = ALL_RUNS, on_fault: OnFault = ignore_fault) -> Verified:
        """Compare every blob of the selected runs with its checksum, and report what is missing, damaged or left over.

        Runs that were begun and have no manifest are reported if nothing happened to them for an hour, and unfinished
        files that a killed program left.
        """
        return verification.verify(self.storage, selection, on_fault)

    def prune(
        self,
        selection: RunSelection | None = None,
        *,
        ids: frozenset[str] = frozenset(),
        grace_s: float = GRACE_S,
        dry: bool = False,
        on_fault: OnFault = ignore_fault,
    ) -> Pruned:
        """Remove runs, then blobs that no run needs and unfinished files that were written more than `grace_s` ago.

        Args:
            selection: which runs to remove; None: no run, unless `ids` names some.
            ids: remove the runs with these ids only, also if their manifests cannot be read.
            grace_s: younger blobs are kept, because another station may be about to use them.
            dry: count what would be removed, and remove nothing.
            on_fault: called with what could not be done.
        """
        return pruning.prune(self.storage, pruning.Request(selection, ids, grace_s, dry), on_fault)


def _storage(url: str | Path) -> Storage:
    text = str(url)
    return FsspecStorage(text.rstrip("/")) if "://" in text else LocalStorage(Path(text).absolute())
