"""The page of `vaoi view`, and what it asks for; on loopback, for one or two people at the machine."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from fastapi import FastAPI, Query
from fastapi.responses import FileResponse, Response

from vaoi_station.api import problems
from vaoi_station.api.pages import FRESH, Assets
from vaoi_station.api.request_guard import RequestGuard
from vaoi_station.config import StationConfig
from vaoi_station.version import __version__
from vaoi_station.viewing.frame_documents import frame_document
from vaoi_station.viewing.latest_frames import LatestFrames

WEB = Path(__file__).parent / "web"
LONGEST_WAIT_S = 5.0


def create_app(config: StationConfig, newest: LatestFrames, notices: Sequence[str]) -> FastAPI:
    """The page and two addresses: `/api/look` (figures and marks) and `/api/cameras/N/picture` (JPEG)."""
    app = FastAPI(title="VAOI view", version=__version__, docs_url=None, redoc_url=None, openapi_url=None)
    problems.install(app)
    app.mount("/web", Assets(directory=WEB), name="web")

    @app.get("/")
    def page() -> FileResponse:
        return FileResponse(WEB / "index.html", headers=FRESH)

    @app.get("/favicon.ico")
    def icon() -> FileResponse:
        return FileResponse(WEB / "icon.svg", headers=FRESH)

    @app.get("/api/look")
    def look(
        response: Response,
        after: Annotated[int, Query(ge=0)] = 0,
        timeout_s: Annotated[float, Query(ge=0, le=LONGEST_WAIT_S)] = 0.0,
    ) -> dict[str, Any]:
        """The newest frame of every camera; waits until there is one with a number beyond `after`."""
        newest.wait(after, timeout_s)
        response.headers["Cache-Control"] = "no-store"
        cameras = [frame_document(shot, config) for shot in newest.shots()]
        names = [c.name for c in config.cameras]
        number = max((c["number"] for c in cameras), default=0)
        return {"station": config.name, "names": names, "number": number, "cameras": cameras, "notices": list(notices)}

    @app.get("/api/cameras/{camera}/picture")
    def picture(camera: int, number: int) -> Response:
        """A frame that `/api/look` has told of."""
        headers = {"Cache-Control": "no-store"}
        return Response(newest.shot(camera, number).jpeg(), media_type="image/jpeg", headers=headers)

    app.add_middleware(RequestGuard)
    return app
