"""The operator's page at `/`, the API at `/docs`, the documents at `/help`, and explanations of problem types.

Every page is a local file and loads nothing from other sites. A page consists of dozens of small files, which are
answered from memory: Starlette's `StaticFiles` finds, opens and reads each in threads of a pool, which costs the
station several times as much as the answer.
"""

from __future__ import annotations

import mimetypes
import stat
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import NamedTuple

from fastapi import FastAPI, Request
from fastapi.responses import PlainTextResponse, RedirectResponse
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.routing import Mount, Route
from starlette.types import Receive, Scope, Send

from vaoi_station.api.addresses import root_of
from vaoi_station.api.http_caching import REVALIDATE, matches, tag_of
from vaoi_station.api.middleware import CSP
from vaoi_station.api.problems import KINDS
from vaoi_station.model.codes import explain

WEB = Path(__file__).parent / "web"
HELP = Path(__file__).parents[1] / "help"
"""The documents as a site, which `docs/build_site` makes; the Debian package has it."""
_PAGES = {"/": "index.html", "/docs": "docs.html", "/favicon.ico": "icon.svg"}
"""Addresses with a file of their own."""
_STYLES = (
    "style.css",
    "line/line.css",
    "boards/boards.css",
    "trends/trends.css",
    "parts/camera_card.css",
    "cameras/cameras.css",
    "setup/setup.css",
    "setup/lights/lights.css",
    "setup/optics/optics.css",
    "setup/settings/settings.css",
    "board/board.css",
)
"""The style sheets of the page in the order in which they apply: later ones before earlier ones."""
_WITHOUT_HELP = "parts/without_help.css"
"""One more for a station that has no documents as pages."""
HELP_POLICY = f"{CSP}; style-src 'self' 'unsafe-inline'"
"""The theme of the documents has styles in its pages; scripts are files."""
_NO_NAMES = frozenset({"", ".", ".."})


class _Kept(NamedTuple):
    """A file as it was read."""

    changed_ns: int
    size: int
    content: bytes
    media_type: str
    tag: str


class StaticFiles:
    """ASGI application of the files in a folder. Browsers revalidate them by ETag: an updated file is shown at once."""

    def __init__(self, folder: Path, policy: str | None = None) -> None:
        self._folder, self._policy = folder, policy
        self._kept: dict[str, _Kept] = {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Reply with the file that is named below the place at which the application is mounted."""
        if scope["method"] not in ("GET", "HEAD"):
            raise HTTPException(405)
        name = scope["path"][len(scope["root_path"]) + 1 :]
        await self._reply(Headers(scope=scope), name)(scope, receive, send)

    def page(self, *names: str) -> Callable[[Request], Awaitable[Response]]:
        """Return the handler of an address of its own for a file, or for several of one type as one file."""

        async def reply(request: Request) -> Response:
            return self._reply(request.headers, *names)

        return reply

    def _reply(self, asked: Headers, *names: str) -> Response:
        """Return a reply with files, or 304 if the browser has them. Directories, and names that lead out, give 404."""
        files = [self._read(name) for name in names]
        content = b"".join(file.content for file in files)
        tag = files[0].tag if len(files) == 1 else tag_of(content)
        headers = {"ETag": tag, "Cache-Control": REVALIDATE}
        if self._policy is not None:
            headers["Content-Security-Policy"] = self._policy
        if matches(asked.get("if-none-match"), tag):
            return Response(status_code=304, headers=headers)
        return Response(content, media_type=files[0].media_type, headers=headers)

    def _read(self, name: str) -> _Kept:
        """Return a file of the folder, which is read again only after a change."""
        # The event loop asks the file system itself: for the station's own files this takes some microseconds, a thread
        # a hundred times as long.
        path = self._folder / name
        try:
            found = path.stat()
            if not stat.S_ISREG(found.st_mode) or not _NO_NAMES.isdisjoint(name.split("/")):
                raise HTTPException(404)
            kept = self._kept.get(name)
            if kept is None or (kept.changed_ns, kept.size) != (found.st_mtime_ns, found.st_size):
                content, media_type = path.read_bytes(), mimetypes.guess_type(name)[0] or "application/octet-stream"
                kept = _Kept(found.st_mtime_ns, found.st_size, content, media_type, tag_of(content))
                self._kept[name] = kept
        except (OSError, ValueError):  # ValueError: the name has a zero byte
            raise HTTPException(404) from None
        return kept


def _has_help() -> bool:
    return (HELP / "docs" / "index.html").is_file()


async def help_page(request: Request) -> Response:
    """Lead to the first page of the documents; say how to make them where there are none."""
    if not _has_help():
        return PlainTextResponse("This installation has no documents as pages: docs/build_site makes them.\n", 404)
    return RedirectResponse(f"{root_of(request.scope)}/help/docs/index.html", 307)


def install(app: FastAPI) -> None:
    """Add the pages to the application. They are not part of the OpenAPI document."""
    files = StaticFiles(WEB)
    # One request in place of one for each view: a browser sends six at a time, and asks for styles before all modules.
    styles = _STYLES if _has_help() else (*_STYLES, _WITHOUT_HELP)
    app.router.routes += [Route("/web/styles.css", files.page(*styles)), Mount("/web", files, name="web")]
    # Routes of Starlette: those of FastAPI would read parameters, which these addresses do not have.
    app.router.routes += [Route(address, files.page(name)) for address, name in _PAGES.items()]

    app.router.routes += [Route("/help", help_page), Mount("/help", StaticFiles(HELP, HELP_POLICY), name="help")]

    @app.get("/problems/{kind}", include_in_schema=False)
    async def problem(request: Request, kind: str) -> PlainTextResponse:
        if kind in KINDS:
            status, title, action = KINDS[kind]
            return PlainTextResponse(f"{title} (HTTP {status}, {kind}).\n{action}\n")
        if explanation := explain(kind):
            return PlainTextResponse(f"{kind}\n\n{explanation}")
        raise HTTPException(404, f"{request.url.path} does not exist.")
