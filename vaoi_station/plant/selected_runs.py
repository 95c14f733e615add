"""The runs that a selection finds in several archives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from hashlib import sha256
from typing import NamedTuple

from vaoi_station.plant.archive import Archive, RunSelection
from vaoi_station.plant.archive.same_recordings import SameRecordings, recording_of


class _Found(NamedTuple):
    """A selected run."""

    archive: Archive
    key: str
    digest: bytes
    """Digest of its manifest."""
    recording: str
    """Digest of its recording."""

    @property
    def address(self) -> str:
        """Address of its manifest."""
        return f"{self.archive.url}/{self.key}"


def select_runs(
    archives: Sequence[str], selection: RunSelection, leave_out: Callable[[str], None]
) -> list[tuple[str, str]]:
    """Return the archive and the key of every selected run, by station, day and id.

    What cannot be used is reported to `leave_out`. A run that several archives have is returned once; if they differ,
    or have it under several stations or days, none is returned, because which of them is meant is not known. A
    recording that was archived under several ids is returned once, and the others are reported.

    Raises:
        InputError: an archive cannot be opened.
    """
    # Keys and digests only: the manifests of a plant's runs would not fit into memory.
    found: dict[str, list[_Found]] = {}
    for url in dict.fromkeys(archives):
        archive = Archive.open(url)
        for run in archive.runs(selection, lambda fault: leave_out(str(fault))):
            digest = sha256(run.text().encode()).digest()
            found.setdefault(run.run, []).append(_Found(archive, run.key, digest, recording_of(run)))
    recordings, chosen = SameRecordings(), list[tuple[str, str]]()
    for same in sorted(found.values(), key=lambda same: same[0].key):
        first = same[0]
        if len({(run.key, run.digest) for run in same}) > 1:
            places = ", ".join(run.address for run in same)
            leave_out(
                f"{first.key}: two runs have this id, and differ: {places}. Remove one from its archive, or give one "
                "archive."
            )
        elif (other := recordings.earlier(first.address, first.recording)) is not None:
            leave_out(
                f"{first.address}: is the same recording as {other}, which is taken. Remove the one "
                "that is wrong from its archive."
            )
        else:
            chosen.append((first.archive.url, first.key))
    return chosen
