"""Routers whose routes are complete, with address, checks and name: the application takes them over as they are."""

from __future__ import annotations

from enum import Enum

from fastapi import APIRouter, Depends
from fastapi.routing import APIRoute

from vaoi_station.api.parameters import refuse_unknown_parameters

PREFIX = "/api/v1"


def rest_router(prefix: str = "", tags: list[str | Enum] | None = None, base: str = PREFIX) -> APIRouter:
    """Return a router for routes below `prefix`.

    `FastAPI.include_router` would add all this too, but it builds each route anew, which takes as long as the first
    time.
    """
    checks = [Depends(refuse_unknown_parameters)]
    return APIRouter(prefix=base + prefix, tags=tags, dependencies=checks, generate_unique_id_function=operation_id)


def operation_id(route: APIRoute) -> str:
    """Return the handler's name, which generated clients use as a method name."""
    return route.name
