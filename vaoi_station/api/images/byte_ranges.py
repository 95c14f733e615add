"""Parts of a reply by byte range (RFC 9110, section 14): some lines of a frame, or the rest of a broken transfer."""

from __future__ import annotations

import re

from fastapi import Request, Response

from vaoi_station.api.http_caching import matches
from vaoi_station.api.problems import problem_response

_ONE_RANGE = re.compile(r"bytes=(\d{0,15})-(\d{0,15})")


def part_of(request: Request, whole: Response) -> Response:
    """Return the part of a reply that the header Range asks for; the whole reply without one.

    Several ranges, and headers that cannot be read, are answered with the whole reply, as the standard permits.
    """
    if whole.status_code != 200:
        return whole
    size = len(whole.body)
    whole.headers["Accept-Ranges"] = "bytes"
    asked = _ONE_RANGE.fullmatch(request.headers.get("range", "").strip())
    if asked is None or asked.groups() == ("", "") or not _still_meant(request, whole):
        return whole
    first, last = asked.groups()
    start = int(first) if first else max(0, size - int(last))
    end = min(int(last) if first and last else size - 1, size - 1)
    if first and last and int(last) < int(first):
        return whole
    if start >= size:
        detail = f"The range begins at byte {start}, but there are {size} bytes."
        headers = {"Content-Range": f"bytes */{size}"}
        return problem_response(request.scope, "range-not-satisfiable", detail, headers=headers)
    headers = {name: value for name, value in whole.headers.items() if name != "content-length"}
    headers["Content-Range"] = f"bytes {start}-{end}/{size}"
    return Response(bytes(whole.body[start : end + 1]), 206, headers)


def _still_meant(request: Request, whole: Response) -> bool:
    """Return whether the caller means these bytes: If-Range names their ETag, or is absent."""
    tag = request.headers.get("if-range")
    return tag is None or (matches(tag, whole.headers.get("etag", "")) and not tag.startswith("W/"))
