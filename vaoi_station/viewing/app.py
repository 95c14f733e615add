"""The web application of `vaoi view`, on loopback only."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from fastapi import FastAPI, Query
from fastapi.responses import Response
from starlette.routing import Mount, Route

from vaoi_station.api import pages, problems
from vaoi_station.api.fast.static_files import StaticFiles
from vaoi_station.api.request_guard import RequestGuard
from vaoi_station.config import StationConfig
from vaoi_station.version import __version__
from vaoi_station.viewing.frame_documents import frame_document
from vaoi_station.viewing.latest_frames import LatestFrames

WEB = Path(__file__).parent / "web"
SHARED = pages.WEB / "parts"
"""Parts of the station's page that this page has too."""
LONGEST_WAIT_S = 5.0
"""Largest time-out that the page may request, s."""


def create_app(config: StationConfig, latest: LatestFrames, notices: Sequence[str]) -> FastAPI:
    """Create the application: the page, `/api/look` (figures and marks), and `/api/cameras/N/picture` (JPEG)."""
    app = FastAPI(title="VAOI view", version=__version__, docs_url=None, redoc_url=None, openapi_url=None)
    problems.install(app)
    files = StaticFiles(WEB)
    app.router.routes += [Mount("/web", files), Mount("/parts", StaticFiles(SHARED))]
    app.router.routes += [Route("/", files.page("index.html")), Route("/favicon.ico", files.page("icon.svg"))]

    @app.get("/api/look")
    def list_frames(
        response: Response,
        after: Annotated[int, Query(ge=0)] = 0,
        timeout_s: Annotated[float, Query(ge=0, le=LONGEST_WAIT_S)] = 0.0,
    ) -> dict[str, Any]:
        """Wait at most `timeout_s` for a frame numbered above `after`; return the latest frame of every camera."""
        # A plain function, so that FastAPI runs it in a thread: waiting must not block the event loop.
        latest.wait(after, timeout_s)
        response.headers["Cache-Control"] = "no-store"
        cameras = [frame_document(frame, config) for frame in latest.frames()]
        names = [c.name for c in config.cameras]
        number = max((c["number"] for c in cameras), default=0)
        return {"station": config.name, "names": names, "number": number, "cameras": cameras, "notices": list(notices)}

    @app.get("/api/cameras/{camera}/picture")
    def picture(camera: int, number: int) -> Response:
        """Return the JPEG of a frame that `/api/look` has listed."""
        headers = {"Cache-Control": "no-store"}
        return Response(latest.frame(camera, number).jpeg(), media_type="image/jpeg", headers=headers)

    app.add_middleware(RequestGuard)
    return app
