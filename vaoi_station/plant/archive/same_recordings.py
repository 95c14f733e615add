"""Finds runs that are one recording, archived under several ids, days or stations."""

from __future__ import annotations

from vaoi_station.plant.archive.manifest import ArchivedRun, digest_of, frames_digest


class SameRecordings:
    """The recordings of the runs that were given to `earlier`.

    Two runs are one recording if their frames and their heads are equal. Equal frames alone are not enough: a station
    that replays a recording films the same frames again, and the head of each run has its id and the times of its rows.
    """

    def __init__(self) -> None:
        self._known: dict[str, str] = {}
        """Addresses by the digest of the recording. Manifests of a plant's runs would not fit into memory."""

    def earlier(self, address: str, recording: str) -> str | None:
        """Return the address of an earlier run that is the same recording; None if there is none.

        Args:
            address: address of the manifest of the run.
            recording: `recording_of` the run.
        """
        first = self._known.setdefault(recording, address) if recording else address
        return None if first == address else first


def recording_of(run: ArchivedRun) -> str:
    """Return a digest of the frames and the head of a run, of what its manifest states; empty if either is absent.

    Heads count as they are stored: equal ones that two releases of zlib compressed differently have two digests. To
    compare their content, each head of a station that replays a recording would have to be read.
    """
    head = run.documents.get("head")
    if head is None or not run.frames:
        return ""
    return digest_of(f"{frames_digest(run.frames)} {head.sha256}".encode())
