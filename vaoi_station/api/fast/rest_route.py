"""The route of an address of REST: quick to decline, and with the same defaults everywhere."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

from fastapi import Request, Response
from fastapi.routing import APIRoute
from starlette.routing import Match
from starlette.types import Scope

from vaoi_station.api.addresses import path_of
from vaoi_station.api.http_caching import LIVE


class RestRoute(APIRoute):
    """A route whose replies leave fields without a value out, and are not cached unless they say so."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **{**options, "response_model_exclude_none": True})

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the handler of FastAPI, whose replies get the default for caches."""
        handle = super().get_route_handler()

        async def handled(request: Request) -> Response:
            response = await handle(request)
            if response.status_code != 204:
                response.headers.setdefault("Cache-Control", LIVE)
            return response

        return handled

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        """Compare the path first: a request is tried by some forty routes, which read more before they compare it."""
        path = path_of(scope) if scope.get("root_path") else scope["path"]
        other = self.path_regex.match(path) is None
        return (Match.NONE, {}) if other else super().matches(scope)


class RouteWithoutQuery(RestRoute):
    """A route for requests without a query; the route for the others follows it, and describes both.

    FastAPI reads each query parameter of a route in every request. For the 19 of a picture this takes as long as the
    rest of the request, and a tester mostly sends none of them.
    """

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        """Match a request without a query as other routes do, and no other request."""
        return (Match.NONE, {}) if scope.get("query_string") else super().matches(scope)
