"""Board data over REST: a file is uploaded, its import previewed and corrected, and confirmed as a board type.

Importers run in processes of their own. Uploads and previews are limited in number, size and age.
"""

from __future__ import annotations

import re
import secrets
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import IO, Annotated, Literal
from urllib.parse import quote

import fastapi
from fastapi import APIRouter, Query, Request, Response
from pydantic import Field

from vaoi_station.api.http_caching import REVALIDATE, conditional_response
from vaoi_station.api.limits import Seats, ThreadLimit, caller_in
from vaoi_station.api.parameters import IfMatch, IfNoneMatch, rest_router
from vaoi_station.api.rest_models import PREVIEW_ID, PlainText
from vaoi_station.api.routes.board_types import document_of, unchanged_board_type
from vaoi_station.api.routes.services import Services
from vaoi_station.board_data.import_process import ImportReply, ImportTask, import_limited
from vaoi_station.board_data.overview import ImportOverview
from vaoi_station.errors import InputError, NotFoundError, VaoiError
from vaoi_station.model import BoardType, Strict
from vaoi_station.model.board_type import STORED_NAME, STORED_NAME_RULE
from vaoi_station.runs.states.run_ids import utc

MOST_PREVIEWS = 10
MOST_BYTES = 512 * 2**20
"""Size of all uploaded files together."""
MOST_REPLIES = 64 * 2**20
"""Size of all replies together, in characters: the station keeps them in memory. One has at most half of it."""
AGE_S = 3600.0
"""A preview that was not used for this time is deleted."""
FormatName = Literal["kicad", "gencad", "ipc2581", "odb", "eagle", "html-bom", "centroid"]
PreviewId = Annotated[str, fastapi.Path(description="Id of a preview.", pattern=PREVIEW_ID)]
BODY = {
    "requestBody": {
        "required": True,
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}
"""OpenAPI description of an upload."""
_SVG_POLICY = "default-src 'none'; style-src 'unsafe-inline'; sandbox"


class ImportOptions(Strict):
    """What a person says about an uploaded file; what is absent is recognised."""

    side: Literal["top", "bottom"] = Field(default="top", description="The side that is up in the line.")
    name: str | None = Field(default=None, max_length=200, description="Name of the board type; else the design's.")
    format: FormatName | None = Field(default=None, description="Format of the file; absent: recognised.")
    units: Literal["mm", "inch", "mil"] | None = Field(default=None, description="Of a centroid file.")
    columns: str | None = Field(
        default=None,
        max_length=500,
        description="Of a centroid file, as `ref=1,x=3,y=Mid Y,rotation=5,side=Layer,fitted=DNP`; `side=bottom` states "
        "the side of all parts, `rotation=none` that there is none.",
    )
    delimiter: str | None = Field(
        default=None, max_length=10, description="Of a centroid file: one character or its name."
    )
    step: str | None = Field(
        default=None, max_length=200, description="Step of an ODB++ design or IPC-2581 file: a board, or its panel."
    )
    repeat: str | None = Field(
        default=None, max_length=40, description="Of a file of one board: boards of the panel along x and y, as `3x2`."
    )
    pitch: str | None = Field(
        default=None, max_length=40, description="With `repeat`: distance from board to board, mm, as `30x28.5`."
    )
    rotate: str | None = Field(
        default=None, max_length=500, description="With `repeat`: rotations of the boards in turn, degrees, as `0,180`."
    )
    border: str | None = Field(
        default=None,
        max_length=40,
        description="With `repeat`: from the outermost boards to the edges of the panel, mm, as `0x5`.",
    )
    sizes: str | None = Field(
        default=None,
        max_length=40_000,
        description="Table of body sizes, in TOML: `[[package]]` with `pattern` and `size`.",
    )
    join: str | None = Field(
        default=None,
        pattern=PREVIEW_ID,
        description="Id of another preview, whose file has bodies and outline, or is a netlist (IPC-D-356).",
    )
    test_points: bool = Field(default=True, description="Keep pads and vias that a probe reaches as test points.")


class UploadOptions(ImportOptions):
    """The parameters of an upload."""

    filename: PlainText = Field(min_length=1, max_length=200, description="Name of the file, for messages.")


class ImportPreview(Strict):
    """An uploaded file, and the board type that it would make."""

    id: str
    filename: str
    size_bytes: int
    expires: str
    options: ImportOptions
    found: ImportOverview | None = Field(default=None, description="Absent if the file was refused.")
    refusal: str | None = Field(default=None, description="Why the file cannot be imported with these options.")
    picture: str | None = Field(default=None, description="Address of the picture, SVG.")
    board_type: str | None = Field(default=None, description="Address of the board type.")


class ImportPreviewList(Strict):
    """All previews, the oldest first."""

    previews: list[ImportPreview]


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


def router(services: Services, previews: Previews) -> APIRouter:
    """Create the routes for imports of board data."""
    routes = rest_router(prefix="/board-data", tags=["board types"])
    # One import at a time: each may take a whole core and much memory. Confirming does not wait for it.
    importing, checking, quick = ThreadLimit(1), ThreadLimit(1), services.commands
    seats = Seats("imports of board data", 6, 3)

    def document(request: Request, preview: Preview) -> ImportPreview:
        return previews.document(preview, f"{_prefix(request)}/board-data/previews")

    @routes.get("/previews")
    async def list_import_previews(request: Request) -> ImportPreviewList:
        """List the uploaded files and what they would make."""
        found = await quick.ask(previews.list)
        return ImportPreviewList(previews=[document(request, preview) for preview in found])

    @routes.post("/previews", status_code=201, openapi_extra=BODY)
    async def upload_board_data(
        request: Request, response: Response, upload: Annotated[UploadOptions, Query()]
    ) -> ImportPreview:
        """Upload a file of a CAD system or placement machine, and return what board type it would make.

        The body is the file as it is: KiCad, GenCAD, IPC-2581, ODB++ (zip, tgz), EAGLE, InteractiveHtmlBom, or a
        centroid file. Nothing is stored until the preview is confirmed.
        """
        with seats.take(caller_in(request.scope).name):
            with previews.uploading(upload.filename) as (file, path):
                empty = True
                async for piece in request.stream():
                    await quick.ask(file.write, piece)
                    empty = empty and not piece
                if empty:
                    raise InputError("body: is empty, but must be the file.")
            options = ImportOptions.model_validate(upload.model_dump(exclude={"filename"}))
            preview = await importing.ask(previews.add, path, options)
        response.headers["Location"] = f"{request.url.path}/{preview.id}"
        return document(request, preview)

    @routes.get("/previews/{preview}")
    async def get_import_preview(request: Request, preview: PreviewId) -> ImportPreview:
        """Return what an uploaded file would make."""
        return document(request, await quick.ask(previews.get, preview))

    @routes.put("/previews/{preview}")
    async def correct_import_preview(request: Request, preview: PreviewId, options: ImportOptions) -> ImportPreview:
        """Import an uploaded file again with other options: side, columns, units, or joined with another file."""
        with seats.take(caller_in(request.scope).name):
            return document(request, await importing.ask(previews.change, preview, options))

    @routes.delete("/previews/{preview}", status_code=204)
    async def delete_import_preview(preview: PreviewId) -> None:
        """Delete an uploaded file and its preview."""
        await quick.ask(previews.drop, preview)

    @routes.get(
        "/previews/{preview}/picture",
        response_class=Response,
        responses={200: {"description": "The picture.", "content": {"image/svg+xml": {"schema": {"type": "string"}}}}},
    )
    async def get_import_picture(preview: PreviewId) -> Response:
        """Return outline, cut-outs, marks and bodies of a preview as SVG. Bodies of guessed size are orange."""
        reply = await quick.ask(previews.reply, preview)
        headers = {"Content-Security-Policy": _SVG_POLICY}
        return Response(reply.picture, media_type="image/svg+xml", headers=headers)

    @routes.get("/previews/{preview}/board-type", response_model=BoardType)
    async def get_imported_board_type(preview: PreviewId) -> Response:
        """Return the board type that a preview would make."""
        reply = await quick.ask(previews.reply, preview)
        return Response(reply.board_type, media_type="application/json")

    @routes.post(
        "/previews/{preview}/confirm",
        response_model=BoardType,
        responses={201: {"model": BoardType, "description": "New."}},
    )
    async def confirm_import(
        request: Request, preview: PreviewId, _: IfMatch = None, __: IfNoneMatch = None
    ) -> Response:
        """Store the board type of a preview, as `PUT board-types/{name}` does, and delete the preview.

        With `If-None-Match: *` it replaces no board type, with `If-Match: ETAG` only the version that the caller has
        read: else 412 `changed`, and the preview stays. Without, one of the same name is replaced, as before.
        """
        reply = await quick.ask(previews.reply, preview)
        board_type = await checking.ask(BoardType.model_validate_json, reply.board_type)
        content = await checking.ask(document_of, board_type)
        if not re.fullmatch(STORED_NAME, board_type.name):
            action = "Set `name` by PUT of the preview."
            raise InputError.field("preview", "name", board_type.name, STORED_NAME_RULE, action=action)
        answer = conditional_response(request, content, "application/json", cache=REVALIDATE)
        async with unchanged_board_type(services, request, board_type.name):
            if await quick.ask(services.coordinator.put_board_type, board_type):
                answer.status_code = 201
                answer.headers["Location"] = f"{_prefix(request)}/board-types/{quote(board_type.name)}"
        with suppress(NotFoundError):  # deleted meanwhile: by another caller, or because others are newer
            await quick.ask(previews.drop, preview)
        return answer

    return routes


def _prefix(request: Request) -> str:
    return request.url.path.partition("/board-data")[0]


def _safe_name(filename: str) -> str:
    """Return the name of an upload without folders and control characters; readers do not depend on it."""
    name = filename.replace("\\", "/").rpartition("/")[2]
    name = "".join(c if c.isprintable() else "_" for c in name).strip(". ")
    return name.encode()[-200:].decode(errors="ignore") or "board-data"
