"""The route of an address of REST, which declines quickly what is not for it."""

from __future__ import annotations

from fastapi.routing import APIRoute
from starlette.routing import Match
from starlette.types import Scope

from vaoi_station.api.addressing.path_prefix import path_of


class RestRoute(APIRoute):
    """A route that compares the path first: a request is tried by some forty routes until one matches."""

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        """Match as other routes do. They read what included routers have added before they compare the path."""
        path = path_of(scope) if scope.get("root_path") else scope["path"]
        other = self.path_regex.match(path) is None
        return (Match.NONE, {}) if other else super().matches(scope)
