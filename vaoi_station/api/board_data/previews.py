"""The uploaded files and their previews: limited in number, size and age, in a temporary folder."""

from __future__ import annotations

import secrets
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
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
    """An uploaded file with the reply of its import."""

    id: str
    file: Path
    size_bytes: int
    options: ImportOptions
    used: float = 0.0
    reply: ImportReply | None = None
    refusal: VaoiError | None = None

    @property
    def reply_size(self) -> int:
        """Number of characters of the reply; its overview is small."""
        return 0 if self.reply is None else len(self.reply.board_type) + len(self.reply.picture)


@dataclass
class _Files:
    """The folder of the uploads; made at the first one."""

    folder: Path | None = None
    kept: dict[str, Preview] = field(default_factory=dict)


class Previews:
    """All previews. Methods may be called from any thread; `import_file` takes seconds."""

    def __init__(
        self,
        import_file: Callable[[ImportTask], ImportReply] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._import, self._clock = import_file, clock
        self._lock = threading.Lock()
        self._files = _Files()

    @contextmanager
    def uploading(self, filename: str) -> Iterator[tuple[IO[bytes], Path]]:
        """Open a new file for an upload, which is deleted if the block fails."""
        with self._lock:
            folder = self._files.folder
            # The system may delete temporary folders that were not used for days.
            if folder is None or not folder.is_dir():
                folder = self._files.folder = Path(tempfile.mkdtemp(prefix="vaoi-board-data-"))
            folder /= secrets.token_hex(8)
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
            self._files.kept[preview.id] = preview
            self._bound(preview.id)
        return preview

    def change(self, preview_id: str, options: ImportOptions) -> Preview:
        """Import the file of a preview again with other options."""
        preview = self._imported(replace(self.get(preview_id), options=options))
        with self._lock:
            if preview_id not in self._files.kept:
                raise _unknown(preview_id)
            self._files.kept[preview_id] = preview
            self._bound(preview_id)
        return preview

    def list(self) -> tuple[Preview, ...]:
        """Return all previews, the oldest first."""
        with self._lock:
            self._bound("")
            return tuple(self._files.kept.values())

    def get(self, preview_id: str) -> Preview:
        """Return a preview, and note that it is in use; `NotFoundError` if there is none."""
        with self._lock:
            self._bound("")
            if preview_id not in self._files.kept:
                raise _unknown(preview_id)
            found = replace(self._files.kept[preview_id], used=self._clock())
            self._files.kept[preview_id] = found
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
        self.get(preview_id)
        with self._lock:
            self._delete(preview_id)

    def close(self) -> None:
        """Delete all uploaded files."""
        with self._lock:
            self._files.kept.clear()
            if self._files.folder is not None:
                shutil.rmtree(self._files.folder, ignore_errors=True)
            self._files.folder = None

    def document(self, preview: Preview, prefix: str) -> ImportPreview:
        """Return the document of a preview; `prefix` is the address of all previews."""
        ready = preview.reply is not None
        left_s = max(0.0, AGE_S - (self._clock() - preview.used))
        return ImportPreview(
            id=preview.id,
            filename=preview.file.name,
            size_bytes=preview.size_bytes,
            expires=utc(datetime.now(UTC) + timedelta(seconds=left_s)),
            options=preview.options,
            found=preview.reply.overview if preview.reply else None,
            refusal=str(preview.refusal) if preview.refusal else None,
            picture=f"{prefix}/{preview.id}/picture" if ready else None,
            board_type=f"{prefix}/{preview.id}/board-type" if ready else None,
        )

    def _imported(self, preview: Preview) -> Preview:
        options = preview.options
        join = self.get(options.join).file if options.join is not None else None
        given = options.model_dump(exclude={"join", "sizes"}) | {"join": join, "size_table": options.sizes}
        try:
            reply = (self._import or import_limited)(ImportTask(file=preview.file, **given))
        except VaoiError as error:
            # Messages name files; the folder is of no use to the caller.
            text = str(error.message).replace(f"{preview.file.parent}/", "")
            text = text if join is None else text.replace(f"{join.parent}/", "")
            refusal = InputError(text, action=error.action, code="unreadable-board-data")
            return replace(preview, reply=None, refusal=refusal, used=self._clock())
        return replace(preview, reply=reply, refusal=None, used=self._clock())

    def _bound(self, newest: str) -> None:
        """Delete previews that are too old, and the least recently used ones until the limits hold."""
        now = self._clock()
        for preview in list(self._files.kept.values()):
            if now - preview.used > AGE_S:
                self._delete(preview.id)
        while self._too_many():
            rest = [p for p in self._files.kept.values() if p.id != newest]
            if not rest:
                return
            self._delete(min(rest, key=lambda p: p.used).id)

    def _too_many(self) -> bool:
        kept = self._files.kept.values()
        sizes, replies = (sum(values) for values in ((p.size_bytes for p in kept), (p.reply_size for p in kept)))
        return len(kept) > MOST_PREVIEWS or sizes > MOST_BYTES or replies > MOST_REPLIES

    def _delete(self, preview_id: str) -> None:
        preview = self._files.kept.pop(preview_id, None)
        if preview is not None:
            shutil.rmtree(preview.file.parent, ignore_errors=True)


def _safe_name(filename: str) -> str:
    """Return the name of an upload without folders and control characters; readers do not depend on it."""
    name = filename.replace("\\", "/").rpartition("/")[2]
    name = "".join(c if c.isprintable() else "_" for c in name).strip(". ")
    return name.encode()[-200:].decode(errors="ignore") or "board-data"


def _unknown(preview_id: str) -> NotFoundError:
    return NotFoundError(
        f"There is no preview {preview_id!r:.40}.",
        action=f"Upload the file again; previews are deleted after {AGE_S / 60:g} min without use, and the least "
        f"recently used of more than {MOST_PREVIEWS}.",
        code="unknown-preview",
    )
