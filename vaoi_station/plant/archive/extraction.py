"""Writes an archived run to a folder, as the station would read it."""

from __future__ import annotations

import zlib
from pathlib import Path

from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.files.atomic_directory import new_directory
from vaoi_station.files.documents import write_bytes
from vaoi_station.files.images import Image, decode, write_image
from vaoi_station.plant.archive.addition import FILES, REFERENCE
from vaoi_station.plant.archive.manifest import ArchivedReference, ArchivedRun, Blob, DocumentBlob, FrameBlob, digest_of
from vaoi_station.plant.archive.storage import Storage


def extract(storage: Storage, run: ArchivedRun, folder: Path) -> Path:
    """Write a run to a new folder; see `Archive.extract`."""
    with new_directory(folder) as draft:
        _write(storage, run, run, draft)
        if run.reference is not None:
            _write(storage, run, run.reference, draft / REFERENCE)
    return folder


def _write(storage: Storage, run: ArchivedRun, content: ArchivedRun | ArchivedReference, folder: Path) -> None:
    """Write documents and frames of a run, or of its reference, to a folder."""
    for kind, blob in content.documents.items():
        write_bytes(folder / FILES[kind], read_document(storage, run, blob), durable=False)
    for frame in content.frames:
        # Uncompressed, because it is read soon, and often.
        path = folder / "frames" / f"c{frame.camera:02d}_r{frame.row:03d}.tiff"
        write_image(path, read_frame(storage, run, frame))


def read_document(storage: Storage, run: ArchivedRun, blob: DocumentBlob) -> bytes:
    """Return a document of a run."""
    content = read_blob(storage, run, blob)
    if not blob.packed:
        return content
    try:
        return zlib.decompress(content)
    except zlib.error as error:
        raise _unreadable(storage, run, blob, error) from error


def read_frame(storage: Storage, run: ArchivedRun, blob: FrameBlob) -> Image:
    """Return the pixels of a frame of a run, as its recording had them."""
    image = decode(read_blob(storage, run, blob))
    if image is None:
        raise _unreadable(storage, run, blob, "it is no picture that this software reads")
    return image


def read_blob(storage: Storage, run: ArchivedRun, blob: Blob) -> bytes:
    """Return a blob of a run, compared with its checksum.

    Raises:
        NotFoundError: it is missing.
        InputError: it is damaged.
    """
    try:
        content = storage.read(blob.key)
    except NotFoundError as error:
        raise NotFoundError(
            f"{storage.url}: run {run.run}: blob {blob.sha256} is missing.",
            action="Restore it from a copy of the archive, or add the run again from its recording.",
        ) from error
    if digest_of(content) != blob.sha256:
        raise InputError(
            f"{storage.url}: run {run.run}: blob {blob.sha256} is damaged: its {len(content)} bytes have another "
            f"SHA-256 (the manifest says {blob.bytes} bytes).",
            action="Restore it from a copy of the archive, or add the run again from its recording.",
        )
    return content


def _unreadable(storage: Storage, run: ArchivedRun, blob: Blob, error: object) -> InputError:
    return InputError(
        f"{storage.url}: run {run.run}: blob {blob.sha256} has the right checksum, but cannot be decoded: {error}.",
        action="Use a newer vaoi_station if it may come from one; otherwise report it to the maintainer with the blob.",
    )
