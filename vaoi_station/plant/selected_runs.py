"""The runs that a selection finds in several archives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from hashlib import sha256

from vaoi_station.plant.archive import Archive, RunSelection


def select_runs(
    archives: Sequence[str], selection: RunSelection, leave_out: Callable[[str], None]
) -> list[tuple[str, str]]:
    """Return the archive and the key of every selected run, by station, day and id.

    What cannot be used is reported to `leave_out`. A run that several archives have is returned once; if they differ,
    none is returned, because which of them is meant is not known.

    Raises:
        InputError: an archive cannot be opened.
    """
    # Keys and digests only: the manifests of a plant's runs would not fit into memory.
    found: dict[str, list[tuple[str, bytes]]] = {}
    for url in dict.fromkeys(archives):
        archive = Archive.open(url)
        for run in archive.runs(selection, lambda fault: leave_out(str(fault))):
            found.setdefault(run.key, []).append((archive.url, sha256(run.text().encode()).digest()))
    chosen = []
    for key in sorted(found):
        same = found[key]
        if len({digest for _, digest in same}) == 1:
            chosen.append((same[0][0], key))
        else:
            places = ", ".join(url for url, _ in same)
            leave_out(
                f"{key}: two runs have this id, and differ: {places}. Remove one from its archive, or give one archive."
            )
    return chosen
