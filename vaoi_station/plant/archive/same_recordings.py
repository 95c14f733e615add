"""Finds runs that are one recording, archived under several ids, days or stations."""

from __future__ import annotations

from vaoi_station.errors import VaoiError
from vaoi_station.plant.archive.catalogue import read_manifest
from vaoi_station.plant.archive.extraction import read_document
from vaoi_station.plant.archive.manifest import ArchivedRun, frames_digest
from vaoi_station.plant.archive.storage import Storage


class SameRecordings:
    """The recordings of the runs that were given to `earlier`.

    Two runs are one recording if their frames and their heads are equal. Equal frames alone are not enough: a station
    that replays a recording films the same frames again, and the head of each run has its id and the times of its rows.
    """

    def __init__(self) -> None:
        self._known: dict[str, list[tuple[Storage, str]]] = {}
        """By the digest of their frames: storages and keys. Manifests of a plant's runs would not fit into memory."""

    def earlier(self, storage: Storage, key: str, frames: str) -> str | None:
        """Return the address of an earlier run that is the same recording; None if there is none.

        Args:
            storage: storage of the run.
            key: place of its manifest.
            frames: `frames_of` the run.
        """
        alike = self._known.setdefault(frames, [])
        # Heads are read only of runs with equal frames, which are hardly ever there.
        head = _head(storage, key) if frames and alike else None
        for other, other_key in alike:
            if head is not None and head == _head(other, other_key):
                return f"{other.url}/{other_key}"
        alike.append((storage, key))
        return None


def frames_of(run: ArchivedRun) -> str:
    """Return a digest of the frames of a run; empty if it has none."""
    return frames_digest(run.frames) if run.frames else ""


def _head(storage: Storage, key: str) -> bytes | None:
    """Return the head of a recording; None if it cannot be read, which is reported where the run is used."""
    try:
        run = read_manifest(storage, key)
        return read_document(storage, run, run.documents["head"])
    except (VaoiError, KeyError):
        return None
