"""Removes runs from an archive, blobs that no run needs, and unfinished files.

Without locks a blob must not go while a station is about to refer to it. Therefore a blob is removed only if no
manifest has it and if it was written longer ago than a grace period; and who adds a run writes a blob again that is
older than half of this period. An addition that takes longer than a quarter of it is refused.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from typing import NamedTuple

from vaoi_station.errors import NotFoundError, VaoiError
from vaoi_station.plant.archive import catalogue
from vaoi_station.plant.archive.fault import ArchiveFault, OnFault
from vaoi_station.plant.archive.manifest import BLOBS, DRAFTS
from vaoi_station.plant.archive.selection import RunSelection
from vaoi_station.plant.archive.storage import Entry, Storage

GRACE_S = 24 * 3600.0
"""Age below which blobs that no run needs are kept."""


class Request(NamedTuple):
    """What to remove; see `Archive.prune`."""

    selection: RunSelection | None
    ids: frozenset[str]
    grace_s: float
    dry: bool


@dataclass
class Pruned:
    """What was removed, or would be."""

    runs: int = 0
    blobs: int = 0
    bytes: int = 0
    drafts: int = 0
    """Number of runs that were begun and never ended."""
    leftovers: int = 0
    """Number of unfinished files of programs that were killed."""
    faults: int = 0


def prune(storage: Storage, request: Request, on_fault: OnFault) -> Pruned:
    """Remove runs and blobs; see `Archive.prune`."""
    pruned = Pruned()

    def report(fault: ArchiveFault) -> None:
        pruned.faults += 1
        on_fault(fault)

    # Before the manifests are read, which may take hours: what is written meanwhile stays.
    now = datetime.now(UTC)
    needed, complete = set[str](), True
    for place in list(catalogue.places(storage)):
        try:
            if _is_named(place, request) or _is_selected(storage, place, request):
                if not request.dry:
                    storage.delete(place.key)
                pruned.runs += 1
            else:
                needed.update(blob.sha256 for blob in catalogue.read_manifest(storage, place.key).blobs)
        except NotFoundError:
            continue  # Another process has removed it meanwhile.
        except VaoiError as error:
            complete = False
            report(ArchiveFault.of(error))
    if not complete:
        report(
            ArchiveFault(
                f"{storage.url}: no blob was removed, because which ones the manifests above need is not known.",
                "Restore these manifests from a copy, or remove them by `vaoi archive prune --run`.",
            )
        )
        return pruned

    def remove_old(entries: Iterable[Entry]) -> int:
        """Remove what is older than the grace period, and return the number."""
        removed = 0
        for entry in list(entries):
            if (now - entry.changed).total_seconds() > request.grace_s:
                if not request.dry:
                    storage.delete(entry.key)
                removed += 1
                pruned.bytes += entry.size
        return removed

    # Unfinished files first: a folder goes with the last object in it.
    pruned.leftovers = remove_old(storage.leftovers())
    pruned.blobs = remove_old(entry for entry in storage.entries(BLOBS) if entry.key.rpartition("/")[2] not in needed)
    pruned.drafts = remove_old(storage.entries(DRAFTS))
    return pruned


def _is_named(place: catalogue.Place, request: Request) -> bool:
    """Return whether a run is to be removed by its id, without reading its manifest."""
    if place.run not in request.ids:
        return False
    station = request.selection.station if request.selection else None
    return station is None or place.station == station or fnmatchcase(place.station, station)


def _is_selected(storage: Storage, place: catalogue.Place, request: Request) -> bool:
    selection = request.selection
    if selection is None or request.ids or not selection.admits_folder(place.station, place.day):
        return False
    return selection.admits(catalogue.read_manifest(storage, place.key))
