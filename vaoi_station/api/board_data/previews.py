"""The uploaded files and their previews: limited in number, size and age, in a temporary folder."""

from __future__ import annotations

import secrets
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import IO

from vaoi_station.api.board_data.models import ImportOptions, ImportPreview
from vaoi_station.board_data.import_process import ImportReply, ImportTask, import_limited
from vaoi_station.errors import InputError, NotFoundError, VaoiError
from vaoi_station.runs.states.run_ids import utc

MOST_PREVIEWS = 10
MOST_BYTES = 512 * 2**20
"""Size of all uploaded files together."""
MOST_REPLIES = 64 * 2**20
"""Size of all replies together, in characters: the station keeps them in memory. One has at most half of it."""
AGE_S = 3600.0
"""A preview that was not used for this time is deleted."""


@dataclass(frozen=True)
class Preview:
    """An uploaded file with the reply of its import, or the refusal."""

    id: str
    file: Path
    size_bytes: int
    options: ImportOptions
    used: float = 0.0
    reply: ImportReply | None = None
    refusal: VaoiError | None = None


class Previews:
    """All previews. Methods may be called from any thread; an import takes seconds."""

    def __init__(
        self,
        import_file: Callable[[ImportTask], ImportReply] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._import, self._clock = import_file, clock
        self._lock = threading.Lock()
        self._folder: Path | None = None
        self._kept: dict[str, Preview] = {}

    @contextmanager
    def uploading(self, filename: str) -> Iterator[tuple[IO[bytes], Path]]:
        """Open a new file for an upload, which is deleted if the block fails."""
        with self._lock:
            # The system may delete temporary folders that were not used for days.
            if self._folder is None or not self._folder.is_dir():
                self._folder = Path(tempfile.mkdtemp(prefix="vaoi-board-data-"))
            folder = self._folder / secrets.token_hex(8)
        folder.mkdir()
        path = folder / _safe_name(filename)
        try:
            with path.open("wb") as file:
                yield file, path
        except BaseException:  # also if the caller has gone; the error is raised again
            shutil.rmtree(folder, ignore_errors=True)
            raise

    def add(self, path: Path, options: ImportOptions) -> Preview:
        """Import an uploaded file. A file that is refused is kept too: other options may make it readable."""
        try:
            preview = self._imported(Preview(path.parent.name, path, path.stat().st_size, options))
        except BaseException:  # no preview refers to the file, so nothing would delete it; the error is raised again
            shutil.rmtree(path.parent, ignore_errors=True)
            raise
        with self._lock:
            self._kept[preview.id] = preview
            self._bound(preview.id)
        return preview

    def change(self, preview_id: str, options: ImportOptions) -> Preview:
        """Import the file of a preview again with other options."""
        preview = self._imported(replace(self.get(preview_id), options=options))
        with self._lock:
            self._known(preview_id)
            self._kept[preview_id] = preview
            self._bound(preview_id)
        return preview

    def list(self) -> tuple[Preview, ...]:
        """Return all previews, the oldest first."""
        with self._lock:
            self._bound()
            return tuple(self._kept.values())

    def get(self, preview_id: str) -> Preview:
        """Return a preview, and note that it is in use; `NotFoundError` if there is none."""
        with self._lock:
            self._bound()
            found = self._kept[preview_id] = replace(self._known(preview_id), used=self._clock())
            return found

    def reply(self, preview_id: str) -> ImportReply:
        """Return what the import of a preview has made; raise its refusal if there is none."""
        preview = self.get(preview_id)
        if preview.reply is None:
            assert preview.refusal is not None
            raise preview.refusal
        return preview.reply

    def drop(self, preview_id: str) -> None:
        """Delete a preview and its file; `NotFoundError` if there is none."""
        with self._lock:
            self._delete(self._known(preview_id))

    def close(self) -> None:
        """Delete all uploaded files."""
        with self._lock:
            self._kept.clear()
            if self._folder is not None:
                shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None

    def document(self, preview: Preview, prefix: str) -> ImportPreview:
        """Return the document of a preview; `prefix` is the address of all previews."""
        address = f"{prefix}/{preview.id}"
        left_s = max(0.0, AGE_S - (self._clock() - preview.used))
        return ImportPreview(
            id=preview.id,
            filename=preview.file.name,
            size_bytes=preview.size_bytes,
            expires=utc(datetime.now(UTC) + timedelta(seconds=left_s)),
            options=preview.options,
            found=preview.reply.overview if preview.reply else None,
            refusal=str(preview.refusal) if preview.refusal else None,
            picture=f"{address}/picture" if preview.reply else None,
            board_type=f"{address}/board-type" if preview.reply else None,
        )

    def _imported(self, preview: Preview) -> Preview:
        options = preview.options
        join = self.get(options.join).file if options.join is not None else None
        given = options.model_dump(exclude={"join", "sizes"}) | {"join": join, "size_table": options.sizes}
        reply = refusal = None
        try:
            reply = (self._import or import_limited)(ImportTask(file=preview.file, **given))
        except VaoiError as error:
            # Messages name files; the folder is of no use to the caller.
            text = str(error.message)
            for file in (preview.file, join or preview.file):
                text = text.replace(f"{file.parent}/", "")
            refusal = InputError(text, action=error.action, code="unreadable-board-data")
        return replace(preview, reply=reply, refusal=refusal, used=self._clock())

    def _known(self, preview_id: str) -> Preview:
        if preview_id not in self._kept:
            raise NotFoundError(
                f"There is no preview {preview_id!r:.40}.",
                action=f"Upload the file again; previews are deleted after {AGE_S / 60:g} min without use, and the "
                f"least recently used of more than {MOST_PREVIEWS}.",
                code="unknown-preview",
            )
        return self._kept[preview_id]

    def _bound(self, newest: str = "") -> None:
        """Delete previews that are too old, and the least recently used ones until the limits hold."""
        for preview in sorted(self._kept.values(), key=lambda p: p.used):
            left = self._kept.values()
            replies = sum(len(p.reply.board_type) + len(p.reply.picture) for p in left if p.reply is not None)
            sizes = sum(p.size_bytes for p in left)
            too_many = len(left) > MOST_PREVIEWS or sizes > MOST_BYTES or replies > MOST_REPLIES
            if self._clock() - preview.used > AGE_S or (too_many and preview.id != newest):
                self._delete(preview)

    def _delete(self, preview: Preview) -> None:
        del self._kept[preview.id]
        shutil.rmtree(preview.file.parent, ignore_errors=True)


def _safe_name(filename: str) -> str:
    """Return the name of an upload without folders and control characters; readers do not depend on it."""
    name = filename.replace("\\", "/").rpartition("/")[2]
    name = "".join(c if c.isprintable() else "_" for c in name).strip(". ")
    return name.encode()[-200:].decode(errors="ignore") or "board-data"
