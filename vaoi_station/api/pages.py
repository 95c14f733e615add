"""The operator's page at `/`, the API documentation at `/docs`, and explanations of problem types.

Every page is a local file and loads nothing from other sites.
"""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI, Request
from fastapi.responses import FileResponse, PlainTextResponse
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from vaoi_station.api.problems import KINDS

WEB = Path(__file__).parent / "web"
FRESH = {"Cache-Control": "no-cache"}


class Assets(StaticFiles):
    """Static files that browsers revalidate by ETag, so that they show an updated file at once."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Return one file. Directories, and paths that lead out of the served directory, give 404."""
        answer = await super().get_response(path, scope)
        answer.headers["Cache-Control"] = "no-cache"
        return answer


def install(app: FastAPI) -> None:
    """Add the pages to the application. They are not part of the OpenAPI document."""
    app.mount("/web", Assets(directory=WEB), name="web")

    @app.get("/", include_in_schema=False)
    async def page() -> FileResponse:
        return FileResponse(WEB / "index.html", headers=FRESH)

    @app.get("/docs", include_in_schema=False)
    async def docs() -> FileResponse:
        return FileResponse(WEB / "docs.html", headers=FRESH)

    @app.get("/favicon.ico", include_in_schema=False)
    async def icon() -> FileResponse:
        return FileResponse(WEB / "icon.svg", headers=FRESH)

    @app.get("/problems/{kind}", include_in_schema=False)
    async def problem(request: Request, kind: str) -> PlainTextResponse:
        if kind not in KINDS:
            raise HTTPException(404, f"{request.url.path} does not exist.")
        status, title, action = KINDS[kind]
        return PlainTextResponse(f"{title} (HTTP {status}, {kind}).\n{action}\n")
