"""Routes under `keys`, `audit` and `session`: keys of callers, the audit log, the login of the page."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import BaseModel, Field

from vaoi_station.api.access import COOKIE, SESSION_S, AccessControl, session_token
from vaoi_station.api.addresses import root_of
from vaoi_station.api.limits import caller_of
from vaoi_station.api.parameters import rest_router
from vaoi_station.api.problems import problem_response
from vaoi_station.api.routes.services import Services
from vaoi_station.files.access_keys import AccessKey, KeyName, NewKey, Scope

Name = Annotated[str, Path(description="Name of a key.", pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]


class KeyRequest(BaseModel):
    """Name and scopes of a new key."""

    name: Annotated[KeyName, Field(description="A new name, which lists and the audit log show.")]
    scopes: Annotated[list[Scope], Field(min_length=1, max_length=4, description="What the key permits.")]


class KeyEntry(BaseModel):
    """One key, without its secret."""

    name: str
    id: str
    scopes: list[Scope]
    created: str


class KeyList(BaseModel):
    """All keys."""

    keys: list[KeyEntry]


class KeySecret(KeyEntry):
    """A key that was just made. Its secret is not stored and cannot be read again."""

    secret: str


class AuditEntries(BaseModel):
    """Entries of the audit log, newest first."""

    entries: list[dict[str, Any]]


class Login(BaseModel):
    """The key with which a page logs in."""

    key: Annotated[str, Field(min_length=1, max_length=200, description="The key.")]


class SessionState(BaseModel):
    """Who the caller is to the station, and what it may do."""

    key: str | None = Field(default=None, description="Name of its key; absent without one.")
    scopes: list[str]


def router(services: Services, access: AccessControl) -> APIRouter:
    """Create the routes for keys, the audit log and logins."""
    routes = rest_router(tags=["access"])
    ask, keys = services.commands.ask, access.keys

    @routes.get("/keys")
    async def list_keys() -> KeyList:
        """List all keys, without their secrets. Needs the scope admin, as all calls for keys do."""
        return KeyList(keys=[KeyEntry(**_fields(k)) for k in await ask(keys.entries)])

    @routes.post("/keys", status_code=201)
    async def create_key(request: KeyRequest) -> KeySecret:
        """Make a key. The reply is the only place where its secret can be read."""
        return _secret(await ask(keys.create, request.name, request.scopes))

    @routes.post("/keys/{name}/rotate")
    async def rotate_key(name: Name) -> KeySecret:
        """Replace a key by a new one with the same name and scopes. The old one is refused from now on."""
        return _secret(await ask(keys.rotate, name))

    @routes.delete("/keys/{name}", status_code=204)
    async def revoke_key(name: Name) -> None:
        """End a key. It is refused from now on, and so are the logins with it."""
        await ask(keys.revoke, name)

    @routes.get("/audit")
    async def get_audit(
        limit: Annotated[int, Query(ge=1, le=1000, description="Largest number of entries.")] = 100,
    ) -> AuditEntries:
        """Return the newest commands and refusals: time, key, address, method, path, query and status."""
        return AuditEntries(entries=await ask(access.audit.newest, limit))

    @routes.get("/session")
    async def get_session(request: Request) -> SessionState:
        """Return who the caller is to the station, and what it may do. Needs no key."""
        caller = caller_of(request)
        return SessionState(key=caller.key, scopes=sorted(caller.scopes))

    @routes.post("/session", response_model=SessionState)
    async def log_in(request: Request, login: Login) -> Response:
        """Log a page in with a key: sets a cookie, valid for 12 h, so that the page need not keep the key."""
        key = await ask(keys.find, login.key.strip())
        if key is None:
            return problem_response(request.scope, "no-key", "The key is not valid.")
        caller, token = access.log_in(request.scope, key)
        state = SessionState(key=key.name, scopes=sorted(caller.scopes))
        answer = Response(state.model_dump_json(), media_type="application/json")
        # Behind a proxy the station itself sees no TLS; the proxy states it.
        tls = "https" in (request.url.scheme, request.headers.get("x-forwarded-proto"))
        answer.set_cookie(COOKIE, token, max_age=SESSION_S, secure=tls, **_cookie(request))
        return answer

    @routes.delete("/session", status_code=204)
    async def log_out(request: Request) -> Response:
        """End the login of the page."""
        if (token := session_token(request.headers)) is not None:
            access.sessions.end(token)
        answer = Response(status_code=204)
        answer.delete_cookie(COOKIE, **_cookie(request))
        return answer

    return routes


def _cookie(request: Request) -> dict[str, Any]:
    # Behind one proxy there may be several stations, each with logins of its own.
    return {"httponly": True, "samesite": "strict", "path": root_of(request.scope) or "/"}


def _fields(key: AccessKey) -> dict[str, Any]:
    return key.model_dump(mode="json", exclude={"sha256"})


def _secret(made: NewKey) -> KeySecret:
    return KeySecret(**_fields(made.key), secret=made.secret)
