"""Compares an archive with its checksums."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

from vaoi_station.errors import VaoiError
from vaoi_station.plant.archive import catalogue
from vaoi_station.plant.archive.catalogue import UNDER_WAY_S
from vaoi_station.plant.archive.extraction import read_blob
from vaoi_station.plant.archive.fault import ArchiveFault, OnFault
from vaoi_station.plant.archive.same_recordings import SameRecordings, recording_of
from vaoi_station.plant.archive.selection import RunSelection
from vaoi_station.plant.archive.storage import Storage


@dataclass
class Verified:
    """What was found."""

    runs: int = 0
    damaged_runs: int = 0
    blobs: int = 0
    bytes: int = 0
    faults: int = 0
    """Number of everything that was reported."""


def verify(storage: Storage, selection: RunSelection, on_fault: OnFault, under_way_s: float = UNDER_WAY_S) -> Verified:
    """Verify runs; see `Archive.verify`."""
    found = Verified()

    def report(fault: ArchiveFault) -> None:
        found.faults += 1
        on_fault(fault)

    # Shared documents and references are read once; the frames of runs are hardly ever shared, and their digests would
    # take memory.
    sound: set[str] = set()
    recordings = SameRecordings()
    for run in catalogue.runs(storage, selection, report, under_way_s):
        found.runs += 1
        address = f"{storage.url}/{run.key}"
        if (other := recordings.earlier(address, recording_of(run))) is not None:
            report(
                ArchiveFault(
                    f"{address}: is the same recording as {other}, with equal frames and head.",
                    "Remove the one that is wrong by `vaoi archive prune --run ID --station NAME`.",
                )
            )
        before = found.faults
        shared = {blob.sha256 for blob in (*run.documents.values(), *(run.reference.blobs if run.reference else ()))}
        for blob in run.blobs:
            if blob.sha256 in sound:
                continue
            try:
                found.bytes += len(read_blob(storage, run, blob))
            except VaoiError as error:
                report(ArchiveFault.of(error))
                continue
            found.blobs += 1
            if blob.sha256 in shared:
                sound.add(blob.sha256)
        found.damaged_runs += found.faults > before
    now = datetime.now(UTC)
    for left in storage.leftovers():
        if (now - left.changed).total_seconds() > under_way_s:
            report(
                ArchiveFault(
                    f"{storage.url}/{left.key}: was left by a program that was killed while it wrote, "
                    f"{left.changed:%Y-%m-%d %H:%M} UTC, {left.size} bytes. No run needs it.",
                    "Remove it by `vaoi archive prune --confirm`.",
                )
            )
    return found
