"""An archive: finished runs of many stations as immutable, content-addressed blobs, and one manifest per run.

Blobs are written first, the manifest last, each by one atomic write: a reader sees a complete run or none, an
interrupted addition goes on where it was, and any number of stations write at the same time without a lock.

Without locks a blob must not go while a station is about to refer to it. Therefore `prune` removes a blob only if no
manifest has it and if it was written longer ago than a grace period; and who adds a run writes a blob again that is
older than half of this period. An addition that takes longer than a quarter of it is refused.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from pathlib import Path

from vaoi_station.errors import InputError, NotFoundError, VaoiError
from vaoi_station.files.directories import new_directory
from vaoi_station.files.documents import check_format, write_bytes
from vaoi_station.files.images import Image, decode, write_image
from vaoi_station.plant import addition, catalogue
from vaoi_station.plant.addition import FILES, REFERENCE
from vaoi_station.plant.catalogue import UNDER_WAY_S, recording_of
from vaoi_station.plant.manifest import (
    BLOBS,
    DRAFTS,
    ArchivedReference,
    ArchivedRun,
    ArchiveFault,
    Blob,
    DocumentBlob,
    FrameBlob,
    OnFault,
    RunLabel,
    RunSelection,
    digest_of,
    ignore_fault,
)
from vaoi_station.plant.storage import Entry, FsspecStorage, LocalStorage, Storage

__all__ = ["Archive", "ArchivedRun", "Pruned", "RunLabel", "RunSelection", "Verified"]

MARKER = "archive.json"
VERSION = 1
ALL_RUNS, AS_RECORDED = RunSelection(), RunLabel()
GRACE_S = 24 * 3600.0


@dataclass
class Verified:
    """What was compared."""

    runs: int = 0
    damaged_runs: int = 0
    blobs: int = 0
    bytes: int = 0
    faults: int = 0


@dataclass
class Pruned:
    """What was removed, or would be."""

    runs: int = 0
    blobs: int = 0
    bytes: int = 0
    drafts: int = 0
    leftovers: int = 0
    faults: int = 0


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
        """Make a new archive, or open the one that is there; InputError if the path has other things."""
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
        """Open a path, or an address that fsspec understands; InputError if there is no archive, or a newer one."""
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

    def runs(
        self, selection: RunSelection = ALL_RUNS, on_fault: OnFault = ignore_fault, under_way_s: float = UNDER_WAY_S
    ) -> Iterator[ArchivedRun]:
        """Yield the selected runs by station, day and id. Manifests that cannot be used are left out and reported.

        Of two runs with one id neither is yielded: which of them is meant is not known. Runs that are half written for
        longer than `under_way_s` are reported.
        """
        places = catalogue.single_places(self.storage, selection, on_fault)
        for manifest in catalogue.read_ahead((self.storage, place.key) for place in places):
            if (run := catalogue.selected(manifest, selection, on_fault)) is not None:
                yield run
        catalogue.report_half_written(self.storage, selection, on_fault, under_way_s)

    def run(self, run: str) -> ArchivedRun:
        """Return the run with an id; InputError if several have it, NotFoundError if none has."""
        places = [place for place in catalogue.places(self.storage) if place.run == run]
        if not places:
            raise NotFoundError(f"{self.url}: has no run {run!r}.", action="See `vaoi archive list`.")
        if len(places) > 1:
            raise catalogue.several(self.storage, places)
        return catalogue.read_manifest(self.storage, places[0].key)

    def extract(self, run: ArchivedRun | str, folder: Path) -> Path:
        """Write a run to a new folder as the station would read it, and return the folder.

        It has all that the archive has of the run. InputError or NotFoundError names a blob that is damaged or missing;
        then nothing is written.
        """
        run = self.run(run) if isinstance(run, str) else run
        with new_directory(folder) as draft:
            self._write(run, run, draft)
            if run.reference is not None:
                self._write(run, run.reference, draft / REFERENCE)
        return folder

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

    def verify(
        self, selection: RunSelection = ALL_RUNS, on_fault: OnFault = ignore_fault, under_way_s: float = UNDER_WAY_S
    ) -> Verified:
        """Compare every blob of the selected runs with its checksum, and report what is missing, damaged or left over.

        Runs that were begun and have no manifest are reported if nothing happened to them for an hour, and unfinished
        files that a killed program left.
        """
        verified = Verified()

        def report(fault: ArchiveFault) -> None:
            verified.faults += 1
            on_fault(fault)

        # Shared documents and references are read once; the frames of runs are hardly ever shared, and their digests
        # would take memory.
        sound: set[str] = set()
        recordings: dict[str, str] = {}
        for run in self.runs(selection, report, under_way_s):
            verified.runs += 1
            address = f"{self.url}/{run.key}"
            if (other := recordings.setdefault(recording_of(run), address)) != address:
                report(
                    ArchiveFault(
                        f"{address}: is the same recording as {other}, with equal frames and head.",
                        "Remove the one that is wrong by `vaoi archive prune --run ID --station NAME`.",
                    )
                )
            before = verified.faults
            reference = run.reference.blobs if run.reference else ()
            shared = {blob.sha256 for blob in (*run.documents.values(), *reference)}
            for blob in run.blobs:
                if blob.sha256 in sound:
                    continue
                try:
                    verified.bytes += len(self._read_blob(run, blob))
                except VaoiError as error:
                    report(ArchiveFault.of(error))
                    continue
                verified.blobs += 1
                if blob.sha256 in shared:
                    sound.add(blob.sha256)
            verified.damaged_runs += verified.faults > before
        now = datetime.now(UTC)
        for left in self.storage.leftovers():
            if (now - left.changed).total_seconds() > under_way_s:
                report(
                    ArchiveFault(
                        f"{self.url}/{left.key}: was left by a program that was killed while it wrote, "
                        f"{left.changed:%Y-%m-%d %H:%M} UTC, {left.size} bytes. No run needs it.",
                        "Remove it by `vaoi archive prune --confirm`.",
                    )
                )
        return verified

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
            dry: count what would be removed, and remove nothing.
        """
        pruned = Pruned()

        def report(fault: ArchiveFault) -> None:
            pruned.faults += 1
            on_fault(fault)

        def is_selected(place: catalogue.Place) -> bool:
            station = selection.station if selection else None
            if place.run in ids:
                # By its id, without reading its manifest.
                return station is None or place.station == station or fnmatchcase(place.station, station)
            if selection is None or ids or not selection.admits_folder(place.station, place.day):
                return False
            return selection.admits(catalogue.read_manifest(self.storage, place.key))

        # Before the manifests are read, which may take hours: what is written meanwhile stays.
        now = datetime.now(UTC)
        needed, complete = set[str](), True
        for place in list(catalogue.places(self.storage)):
            try:
                if is_selected(place):
                    if not dry:
                        self.storage.delete(place.key)
                    pruned.runs += 1
                else:
                    needed.update(blob.sha256 for blob in catalogue.read_manifest(self.storage, place.key).blobs)
            except NotFoundError:
                continue  # Another process has removed it meanwhile.
            except VaoiError as error:
                complete = False
                report(ArchiveFault.of(error))
        if not complete:
            report(
                ArchiveFault(
                    f"{self.url}: no blob was removed, because which ones the manifests above need is not known.",
                    "Restore these manifests from a copy, or remove them by `vaoi archive prune --run`.",
                )
            )
            return pruned

        def remove_old(entries: Iterable[Entry]) -> int:
            removed = 0
            for entry in list(entries):
                if (now - entry.changed).total_seconds() > grace_s:
                    if not dry:
                        self.storage.delete(entry.key)
                    removed += 1
                    pruned.bytes += entry.size
            return removed

        # Unfinished files first: a folder goes with the last object in it.
        pruned.leftovers = remove_old(self.storage.leftovers())
        pruned.blobs = remove_old(e for e in self.storage.entries(BLOBS) if e.key.rpartition("/")[2] not in needed)
        pruned.drafts = remove_old(self.storage.entries(DRAFTS))
        return pruned

    def _write(self, run: ArchivedRun, content: ArchivedRun | ArchivedReference, folder: Path) -> None:
        for kind, blob in content.documents.items():
            write_bytes(folder / FILES[kind], self._read_document(run, blob), durable=False)
        for frame in content.frames:
            # Uncompressed, because it is read soon, and often.
            path = folder / "frames" / f"c{frame.camera:02d}_r{frame.row:03d}.tiff"
            write_image(path, self._read_frame(run, frame))

    def _read_document(self, run: ArchivedRun, blob: DocumentBlob) -> bytes:
        content = self._read_blob(run, blob)
        try:
            return zlib.decompress(content) if blob.packed else content
        except zlib.error as error:
            raise self._undecodable(run, blob, error) from error

    def _read_frame(self, run: ArchivedRun, blob: FrameBlob) -> Image:
        image = decode(self._read_blob(run, blob))
        if image is None:
            raise self._undecodable(run, blob, "it is no picture that this software reads")
        return image

    def _read_blob(self, run: ArchivedRun, blob: Blob) -> bytes:
        """Return a blob of a run; InputError or NotFoundError if it is damaged or missing."""
        action = "Restore it from a copy of the archive, or add the run again from its recording."
        try:
            content = self.storage.read(blob.key)
        except NotFoundError as error:
            message = f"{self.url}: run {run.run}: blob {blob.sha256} is missing."
            raise NotFoundError(message, action=action) from error
        if digest_of(content) != blob.sha256:
            raise InputError(
                f"{self.url}: run {run.run}: blob {blob.sha256} is damaged: its {len(content)} bytes have another "
                f"SHA-256 (the manifest says {blob.bytes} bytes).",
                action=action,
            )
        return content

    def _undecodable(self, run: ArchivedRun, blob: Blob, cause: object) -> InputError:
        return InputError(
            f"{self.url}: run {run.run}: blob {blob.sha256} has the right checksum, but cannot be decoded: {cause}.",
            action="Use a newer vaoi_station if it may come from one; otherwise report it to the maintainer with the "
            "blob.",
        )


def _storage(url: str | Path) -> Storage:
    text = str(url)
    return FsspecStorage(text.rstrip("/")) if "://" in text else LocalStorage(Path(text).absolute())
