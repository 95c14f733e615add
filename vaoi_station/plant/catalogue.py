"""Which manifests an archive has, and what they say."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote

from vaoi_station.errors import InputError, NotFoundError, VaoiError
from vaoi_station.files.documents import check_format, parse, refuse_duplicate_keys
from vaoi_station.plant.manifest import (
    DRAFTS,
    RUNS,
    ArchivedRun,
    ArchiveFault,
    OnFault,
    RunSelection,
    digest_of,
    frames_digest,
)
from vaoi_station.plant.storage import Storage

READERS = 16
AHEAD = 4 * READERS
UNDER_WAY_S = 3600.0
"""A run that was begun less than this ago may be under way."""


class Place(NamedTuple):
    """Where a manifest is."""

    key: str
    station: str
    day: str
    run: str


def places(storage: Storage) -> Iterator[Place]:
    """Yield the places of all manifests by station, day and id, without reading them."""
    for folder in storage.names(RUNS):
        for day in storage.names(f"{RUNS}/{folder}"):
            for name in storage.names(f"{RUNS}/{folder}/{day}"):
                yield Place(f"{RUNS}/{folder}/{day}/{name}", unquote(folder), day, name.removesuffix(".json"))


def single_places(storage: Storage, selection: RunSelection, on_fault: OnFault) -> list[Place]:
    """Return the places in which selected runs can be, without reading them; those of one id are reported instead."""
    same: dict[str, list[Place]] = {}
    for place in _admitted(storage, selection, on_fault):
        same.setdefault(place.run, []).append(place)
    for places_of in same.values():
        if len(places_of) > 1:
            on_fault(ArchiveFault.of(several(storage, places_of)))
    return [places_of[0] for places_of in same.values() if len(places_of) == 1]


def selected(manifest: Future[ArchivedRun], selection: RunSelection, on_fault: OnFault) -> ArchivedRun | None:
    """Return the run of a manifest that is being read; None if it is not selected, or cannot be used."""
    try:
        run = manifest.result()
        return run if selection.admits(run) else None
    except NotFoundError:
        return None  # It was pruned meanwhile.
    except VaoiError as error:
        on_fault(ArchiveFault.of(error))
        return None


def read_ahead(found: Iterable[tuple[Storage, str]]) -> Iterator[Future[ArchivedRun]]:
    """Read manifests, many at a time, and yield them in the same order: an object store replies after many ms."""
    under_way: deque[Future[ArchivedRun]] = deque()
    pool = ThreadPoolExecutor(READERS, "vaoi-manifests")
    try:
        for storage, key in found:
            under_way.append(pool.submit(read_manifest, storage, key))
            if len(under_way) >= AHEAD:
                yield under_way.popleft()
        yield from under_way
    finally:
        pool.shutdown(cancel_futures=True)


def report_half_written(
    storage: Storage, selection: RunSelection, on_fault: OnFault, under_way_s: float = UNDER_WAY_S
) -> None:
    """Report the selected runs whose addition began more than `under_way_s` ago and did not end."""
    now = datetime.now(UTC)
    for draft in storage.entries(DRAFTS):
        if (now - draft.changed).total_seconds() <= under_way_s:
            continue
        try:
            if not selection.admits(parse(ArchivedRun, read_document(storage, draft.key), draft.key)):
                continue
        except NotFoundError:
            continue  # Its addition has just ended.
        except VaoiError:
            pass  # It is damaged: which run was meant is not known.
        on_fault(
            ArchiveFault(
                f"{storage.url}: run {draft.key.removeprefix(f'{DRAFTS}/').removesuffix('.json')} is half written: "
                f"its addition began at {draft.changed:%Y-%m-%d %H:%M} UTC and did not end.",
                "Add it again, which goes on where it ended, or remove what is there by `vaoi archive prune`.",
            )
        )


def _admitted(storage: Storage, selection: RunSelection, on_fault: OnFault) -> Iterator[Place]:
    """Yield the places in which selected runs can be; a folder that is no day of an archive is reported once."""
    known: dict[tuple[str, str], bool] = {}
    for place in places(storage):
        folder = (place.station, place.day)
        if folder not in known:
            try:
                known[folder] = selection.admits_folder(*folder)
            except InputError:
                known[folder] = False
                on_fault(
                    ArchiveFault(
                        f"{storage.url}/{place.key.rpartition('/')[0]}: is no day (YYYY-MM-DD) of a station.",
                        "It is not of the archive: other programs put such folders on shares. Remove it.",
                    )
                )
        if known[folder]:
            yield place


def read_manifest(storage: Storage, key: str) -> ArchivedRun:
    """Read one manifest; InputError if it is damaged, newer than the software, or of another run."""
    where = f"{storage.url}/{key}"
    data = read_document(storage, key)
    check_format(data, Path(where), "vaoi-archived-run", 1)
    run = parse(ArchivedRun, data, where, "Restore it from a copy, or remove it by `vaoi archive prune --run`.")
    if run.key != key:
        raise InputError(
            f"{where}: is the manifest of {run.key}.", action="Remove the copy by `vaoi archive prune --run`."
        )
    return run


def read_document(storage: Storage, key: str) -> object:
    """Read a JSON object of an archive; InputError if it is damaged."""
    try:
        return json.loads(storage.read(key), object_pairs_hook=refuse_duplicate_keys)
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"{storage.url}/{key}: not valid JSON ({error}).",
            action="It is damaged: restore it from a copy, or remove it by `vaoi archive prune --run`.",
        ) from error


def several(storage: Storage, found: list[Place]) -> InputError:
    """Return the error of several runs with one id."""
    return InputError(
        f"{storage.url}: {len(found)} runs have the id {found[0].run}: {', '.join(place.key for place in found)}.",
        action="Which is meant is not known: remove all but one by `vaoi archive prune --run ID --station NAME`.",
    )


def recording_of(run: ArchivedRun) -> str:
    """Return what equals that of another run if both are one recording: a digest of frames and head as stored.

    Equal frames alone are not enough: a station that replays a recording films the same frames again, and the head of
    each run has its id and the times of its rows.
    """
    head = run.documents.get("head")
    if head is None or not run.frames:
        return run.key
    return digest_of(f"{frames_digest(run.frames)} {head.sha256}".encode())
