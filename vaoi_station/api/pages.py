"""The operator's page at `/`, the API documentation at `/docs`, and explanations of problem types.

Every page is a local file and loads nothing from other sites.
"""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI, Request
from fastapi.responses import PlainTextResponse
from starlette.exceptions import HTTPException
from starlette.routing import Mount, Route

from vaoi_station.api.fast.static_files import StaticFiles
from vaoi_station.api.problems import KINDS

WEB = Path(__file__).parent / "web"
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


def install(app: FastAPI) -> None:
    """Add the pages to the application. They are not part of the OpenAPI document."""
    files = StaticFiles(WEB)
    # One request in place of one for each view: a browser sends six at a time, and asks for styles before all modules.
    app.router.routes += [Route("/web/styles.css", files.joined(_STYLES)), Mount("/web", files, name="web")]
    # Routes of Starlette: those of FastAPI would read parameters, which these addresses do not have.
    app.router.routes += [Route(address, files.page(name)) for address, name in _PAGES.items()]

    @app.get("/problems/{kind}", include_in_schema=False)
    async def problem(request: Request, kind: str) -> PlainTextResponse:
        if kind not in KINDS:
            raise HTTPException(404, f"{request.url.path} does not exist.")
        status, title, action = KINDS[kind]
        return PlainTextResponse(f"{title} (HTTP {status}, {kind}).\n{action}\n")
