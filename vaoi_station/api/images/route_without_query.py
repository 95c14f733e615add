"""The route of requests without a query, beside one with many query parameters.

FastAPI looks for every query parameter of a route in every request, and validates its default. For the 19 parameters of
a picture this takes as long as the rest of its request, and most callers send none of them.
"""

from __future__ import annotations

from starlette.routing import Match
from starlette.types import Scope

from vaoi_station.api.fast.rest_route import RestRoute


class RouteWithoutQuery(RestRoute):
    """A route for requests without a query. The route for all others must follow it, and describe both."""

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        """Match a request without a query as other routes do, and no other request."""
        return (Match.NONE, {}) if scope.get("query_string") else super().matches(scope)
