"""The runs that a selection finds in several archives."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from vaoi_station.errors import VaoiError
from vaoi_station.plant.archive import Archive, RunSelection
from vaoi_station.plant.catalogue import (
    read_ahead,
    recording_of,
    report_half_written,
    selected,
    single_places,
)
from vaoi_station.plant.manifest import ArchivedRun, ArchiveFault


class SelectedRun(NamedTuple):
    """A run of which one archive is to be read."""

    archive: str
    key: str
    manifest: str
    """Digest of its manifest: any other run under its id has another one, and so has the run before a change."""


class _Place(NamedTuple):
    archive: Archive
    key: str

    @property
    def address(self) -> str:
        """Address of the manifest."""
        return f"{self.archive.url}/{self.key}"


class SelectedRuns:
    """Every run that a selection finds in several archives, by station, day and id.

    What cannot be used is reported to `leave_out`. A run that several archives have is yielded once; if they differ,
    or have it under several stations or days, it is not, because which of them is meant is not known. A recording that
    was archived under several ids is yielded once, and the others are reported.

    The archives are listed at once. Manifests are read while the runs are iterated, a bounded number ahead.
    """

    def __init__(self, archives: Sequence[str], selection: RunSelection, leave_out: Callable[[str], None]) -> None:
        """List the archives. Of several, one that cannot be used is reported; if none can, VaoiError is raised."""
        self._selection, self._leave_out = selection, leave_out
        found: dict[str, list[_Place]] = {}
        failures: list[VaoiError] = []
        given = dict.fromkeys(archives)
        for url in given:
            try:
                archive = Archive.open(url)
                for place in single_places(archive.storage, selection, self._report):
                    found.setdefault(place.run, []).append(_Place(archive, place.key))
                report_half_written(archive.storage, selection, self._report)
            except VaoiError as error:
                failures.append(error)
        if failures and len(failures) == len(given):
            raise failures[0]
        for failure in failures:
            leave_out(str(failure))
        # Of one recording under several ids, the first is taken: places are known without manifests, but of a run
        # with several places only those count whose manifests can be used.
        groups = (self._usable(same) if len({place.key for place in same}) > 1 else same for same in found.values())
        self._groups = sorted((same for same in groups if same), key=lambda same: same[0].key)
        self.runs = len(self._groups)
        """Number of runs; while not all manifests are read, the most that it can be."""

    @property
    def archives(self) -> list[str]:
        """Addresses of the archives from which runs may be read."""
        return list(dict.fromkeys(place.archive.url for same in self._groups for place in same))

    def __iter__(self) -> Iterator[SelectedRun]:
        recordings: dict[str, str] = {}
        manifests = read_ahead((place.archive.storage, place.key) for same in self._groups for place in same)
        for places in self._groups:
            read = [(place, selected(next(manifests), self._selection, self._report)) for place in places]
            same = [(place, run) for place, run in read if run is not None]
            if same and (chosen := self._chosen(same, recordings)) is not None:
                yield chosen
            else:
                self.runs -= 1

    def _chosen(self, same: list[tuple[_Place, ArchivedRun]], recordings: dict[str, str]) -> SelectedRun | None:
        """Return the run that several archives may have; None, with a report, if it is not to be used."""
        place, run = same[0]
        if len(same) > 1 and len({(other.key, other.digest) for _, other in same}) > 1:
            addresses = ", ".join(other.address for other, _ in same)
            self._leave_out(
                f"{place.key}: two runs have this id, and differ: {addresses}. Remove one from its archive, or give "
                "one archive."
            )
            return None
        if (earlier := recordings.setdefault(recording_of(run), place.address)) != place.address:
            self._leave_out(
                f"{place.address}: is the same recording as {earlier}, which is taken. Remove the one that is wrong "
                "from its archive."
            )
            return None
        return SelectedRun(place.archive.url, place.key, run.digest)

    def _usable(self, places: list[_Place]) -> list[_Place]:
        manifests = read_ahead((place.archive.storage, place.key) for place in places)
        read = zip(places, manifests, strict=True)
        return [place for place, manifest in read if selected(manifest, self._selection, self._report) is not None]

    def _report(self, fault: ArchiveFault) -> None:
        self._leave_out(str(fault))
