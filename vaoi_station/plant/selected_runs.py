"""The runs that a selection finds in several archives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from vaoi_station.errors import VaoiError
from vaoi_station.plant.archive import Archive, RunSelection
from vaoi_station.plant.archive.same_recordings import SameRecordings, recording_of


class SelectedRun(NamedTuple):
    """A run of which one archive is to be read."""

    archive: str
    key: str
    """Place of its manifest."""
    manifest: str
    """Digest of its manifest: any other run under its id has another one, and so has the run before a change."""


class _Found(NamedTuple):
    """A selected run."""

    archive: Archive
    key: str
    digest: str
    """Digest of its manifest."""
    recording: str
    """Digest of its recording."""

    @property
    def address(self) -> str:
        """Address of its manifest."""
        return f"{self.archive.url}/{self.key}"


def select_runs(
    archives: Sequence[str], selection: RunSelection, leave_out: Callable[[str], None]
) -> list[SelectedRun]:
    """Return every selected run, by station, day and id.

    What cannot be used is reported to `leave_out`. A run that several archives have is returned once; if they differ,
    or have it under several stations or days, none is returned, because which of them is meant is not known. A
    recording that was archived under several ids is returned once, and the others are reported.

    Of several archives one that is absent, or newer than the software, is reported, and the others are used.

    Raises:
        VaoiError: no archive can be used.
    """
    # Keys and digests only: the manifests of a plant's runs would not fit into memory.
    found: dict[str, list[_Found]] = {}
    failures: list[VaoiError] = []
    given = dict.fromkeys(archives)
    for url in given:
        try:
            archive = Archive.open(url)
            for run in archive.runs(selection, lambda fault: leave_out(str(fault))):
                found.setdefault(run.run, []).append(_Found(archive, run.key, run.digest, recording_of(run)))
        except VaoiError as error:
            failures.append(error)
    if failures and len(failures) == len(given):
        raise failures[0]
    for failure in failures:
        leave_out(str(failure))
    recordings, chosen = SameRecordings(), list[SelectedRun]()
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
            chosen.append(SelectedRun(first.archive.url, first.key, first.digest))
    return chosen
