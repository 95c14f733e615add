"""HTTP caching: results and pictures may be cached for ever, live state never.

Results and pictures of a finished run do not change. Their replies carry an ETag (a hash of the bytes) and `immutable`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

from fastapi import Request, Response

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
    # 32 hex digits are 128 bits of SHA-256: no accidental collision.
    tag = f'"{hashlib.sha256(content).hexdigest()[:32]}"'
    kept = {"ETag": tag, "Cache-Control": cache, "Vary": "Accept"}
    if matches(request.headers.get("if-none-match"), tag):
        return Response(status_code=304, headers=kept)
    return Response(content, media_type=media_type, headers={**kept, **(headers or {})})


def matches(if_none_match: str | None, tag: str) -> bool:
    """Return whether an If-None-Match header contains the ETag `tag`."""
    if if_none_match is None:
        return False
    # RFC 9110, section 13.1.2: If-None-Match uses the weak comparison, which ignores the prefix W/.
    tags = [t.strip().removeprefix("W/") for t in if_none_match.split(",")]
    return "*" in tags or tag in tags
