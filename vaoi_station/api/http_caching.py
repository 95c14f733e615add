"""HTTP caching and conditions: results and pictures of finished runs may be cached for ever, live state never.

Their replies carry an ETag, a hash of the bytes, which is also the condition of a change (If-Match, If-None-Match).
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

from fastapi import Request, Response
from pydantic import BaseModel

from vaoi_station.errors import VaoiError

# "private": results belong to one line; a shared proxy must not store them.
IMMUTABLE = "private, max-age=31536000, immutable"
REVALIDATE = "no-cache"
LIVE = "no-store"


def conditional_response(
    request: Request,
    content: bytes,
    media_type: str,
    *,
    cache: str = IMMUTABLE,
    headers: Mapping[str, str] | None = None,
) -> Response:
    """Return a reply with the content and its ETag, or 304 if the client already has the same bytes (If-None-Match)."""
    tag = tag_of(content)
    kept = {"ETag": tag, "Cache-Control": cache, "Vary": "Accept"}
    # With a change, If-None-Match is a condition of the change, which `require_unchanged` has checked.
    if request.method in ("GET", "HEAD") and matches(request.headers.get("if-none-match"), tag):
        return Response(status_code=304, headers=kept)
    return Response(content, media_type=media_type, headers={**kept, **(headers or {})})


def json_of(document: BaseModel) -> bytes:
    """Return a document as JSON, in which fields without a value are left out."""
    return document.model_dump_json(exclude_none=True).encode()


def json_response(request: Request, document: BaseModel | bytes, cache: str = IMMUTABLE) -> Response:
    """Return `conditional_response` with a document."""
    content = document if isinstance(document, bytes) else json_of(document)
    return conditional_response(request, content, "application/json", cache=cache)


def tag_of(content: bytes) -> str:
    """Return the ETag of a document."""
    # 32 hex digits are 128 bits of SHA-256: no accidental collision.
    return f'"{hashlib.sha256(content).hexdigest()[:32]}"'


class ChangedError(VaoiError):
    """What a caller wants to change is not what it has read."""

    code = "changed"
    status = 412


def require_unchanged(request: Request, present: bytes | None, what: str) -> None:
    """Raise ChangedError if a change is asked under a condition that does not hold (If-Match, If-None-Match).

    `present` is the document as it is now, None if there is none; `what` is what is to be changed, for the message.
    """
    tag = None if present is None else tag_of(present)
    if_match, if_none_match = request.headers.get("if-match"), request.headers.get("if-none-match")
    # RFC 9110, section 13.1.1: If-Match uses the strong comparison, in which a weak tag never matches.
    if if_match is not None and (tag is None or not {"*", tag} & _tags(if_match)):
        state = "does not exist any more" if tag is None else f"has changed since it was read; its ETag is {tag}"
        raise ChangedError(
            f"{what} {state}, but If-Match is {if_match!r:.80}; nothing was changed.",
            action="Read it again, make the change to what is there now, and send it with the new ETag.",
        )
    if tag is not None and matches(if_none_match, tag):
        raise ChangedError(
            f"{what} exists, but If-None-Match is {if_none_match!r:.80}; nothing was changed.",
            action="Choose another name, or replace it without If-None-Match.",
        )


def matches(if_none_match: str | None, tag: str) -> bool:
    """Return whether an If-None-Match header contains the ETag `tag`."""
    # RFC 9110, section 13.1.2: If-None-Match uses the weak comparison, which ignores the prefix W/.
    return bool({"*", tag} & {named.removeprefix("W/") for named in _tags(if_none_match or "")})


def _tags(header: str) -> set[str]:
    return {tag.strip() for tag in header.split(",")}
