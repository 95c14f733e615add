"""What may be kept by whom: finished things for ever, live things never.

Finished runs do not change, so their answers carry a strong ETag (a hash of the bytes) and `immutable`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

from fastapi import Request, Response

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
    """The answer with its ETag, or 304 when the caller holds the same bytes (If-None-Match)."""
    tag = f'"{hashlib.sha256(content).hexdigest()[:32]}"'
    kept = {"ETag": tag, "Cache-Control": cache, "Vary": "Accept"}
    if matches(request.headers.get("if-none-match"), tag):
        return Response(status_code=304, headers=kept)
    return Response(content, media_type=media_type, headers={**kept, **(headers or {})})


def matches(if_none_match: str | None, tag: str) -> bool:
    """Whether an If-None-Match header names the tag; the comparison is weak, as RFC 9110 wants it."""
    if if_none_match is None:
        return False
    named = [t.strip().removeprefix("W/") for t in if_none_match.split(",")]
    return "*" in named or tag in named
