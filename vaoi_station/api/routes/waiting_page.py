"""The reply of the service while the station cannot be started yet: the cause, with status 503.

A browser, which may be the only program of a panel, gets a page that asks again by itself.
"""

from __future__ import annotations

import socket
from collections.abc import Iterable
from html import escape

from fastapi import FastAPI, Response
from fastapi.requests import Request
from fastapi.responses import FileResponse, HTMLResponse

from vaoi_station.api.addresses import path_of, root_of
from vaoi_station.api.certificate import CertificateFiles
from vaoi_station.api.middleware import API, guards
from vaoi_station.api.pages import WEB
from vaoi_station.api.problems import problem_response
from vaoi_station.api.web_server import WebServer
from vaoi_station.errors import VaoiError

AGAIN_S = 5
"""Time after which a browser asks again, s."""
STYLE = "/web/style.css"
_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>Not started</title>
<link rel="stylesheet" href="{style}">
</head>
<body>
<main class="not-started">
<h1>Not started</h1>
<p>Hold boards back. Call the administrator.</p>
<h1 lang="de">Nicht gestartet</h1>
<p lang="de">Baugruppen zurückhalten. Administrator rufen.</p>
<h2>{code}</h2>
<p class="cause">{cause}</p>
</main>
</body>
</html>
"""


class WaitingPage:
    """A web server that replies to every request with the cause for which the station waits.

    It starts with the first report, and ends with the context.
    """

    def __init__(
        self,
        listener: socket.socket,
        names: Iterable[str],
        tls: CertificateFiles | None = None,
        root_path: str = "",
    ) -> None:
        """Prepare to reply on a copy of `listener`, under `names` and below `root_path`; with TLS if `tls` is given."""
        self._listener, self._names, self._tls, self._root_path = listener, tuple(names), tls, root_path
        self._error: VaoiError | None = None
        self._server: WebServer | None = None

    def report(self, error: VaoiError) -> None:
        """Show a cause from now on."""
        self._error = error
        if self._server is None:
            # A copy is used, because the server closes its socket at its end, and the station's own server needs it
            # then.
            self._server = WebServer(self._app(), self._listener.dup(), lambda: None, self._tls)
            self._server.start()

    def __enter__(self) -> WaitingPage:
        return self

    def __exit__(self, *_: object) -> None:
        if self._server is not None:
            self._server.stop()

    def _app(self) -> FastAPI:
        checked = guards(self._names, root_path=self._root_path)
        app = FastAPI(openapi_url=None, docs_url=None, redoc_url=None, middleware=checked)

        @app.get(STYLE)
        async def style() -> FileResponse:
            return FileResponse(WEB / "style.css", headers={"Cache-Control": "no-cache"})

        # Every method and address has the same reply, so that no caller takes it for a reply of the station.
        @app.api_route("/{path:path}", methods=["GET", "HEAD", "POST", "PUT", "DELETE"])
        async def waiting(request: Request) -> Response:
            error = self._error
            assert error is not None
            if "text/html" in request.headers.get("accept", "") and not path_of(request.scope).startswith(API):
                return _page(error, root_of(request.scope))
            detail = f"The station is not started yet: {error.message}"
            return problem_response(request.scope, error.code, detail, status=503, action=error.action)

        return app


def _page(error: VaoiError, root: str) -> HTMLResponse:
    """Return the page for a browser, which loads it again until the station is there."""
    cause = escape(f"{error.message} {error.action}".strip())
    content = _PAGE.format(style=escape(root + STYLE), code=escape(error.code), cause=cause)
    return HTMLResponse(content, status_code=503, headers={"Cache-Control": "no-store", "Refresh": str(AGAIN_S)})
