"""ETags and conditional requests."""

from __future__ import annotations

from contextlib import nullcontext

import pytest
from fastapi import Request
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.api.http_caching import (
    IMMUTABLE,
    LIVE,
    ChangedError,
    conditional_response,
    matches,
    require_unchanged,
    tag_of,
)


def request(if_none_match: str | None = None) -> Request:
    headers = [] if if_none_match is None else [(b"if-none-match", if_none_match.encode())]
    return Request({"type": "http", "method": "GET", "headers": headers})


def change(**conditions: str) -> Request:
    headers = [(name.replace("_", "-").encode(), value.encode()) for name, value in conditions.items()]
    return Request({"type": "http", "method": "PUT", "headers": headers})


OLD, NEW = b"old", b"new"


@pytest.mark.parametrize(
    ("conditions", "present", "allowed"),
    [
        ({}, OLD, True),
        ({}, None, True),
        ({"if_match": tag_of(OLD)}, OLD, True),
        ({"if_match": f'"x", {tag_of(OLD)}'}, OLD, True),
        ({"if_match": tag_of(OLD)}, NEW, False),
        ({"if_match": f"W/{tag_of(OLD)}"}, OLD, False),
        ({"if_match": "*"}, OLD, True),
        ({"if_match": "*"}, None, False),
        ({"if_match": tag_of(OLD)}, None, False),
        ({"if_none_match": "*"}, None, True),
        ({"if_none_match": "*"}, OLD, False),
        ({"if_none_match": tag_of(OLD)}, NEW, True),
    ],
)
def test_a_change_is_made_only_to_what_was_read(
    conditions: dict[str, str], present: bytes | None, allowed: bool
) -> None:
    with nullcontext() if allowed else pytest.raises(ChangedError, match=r"Board type 'x' .*nothing was changed"):
        require_unchanged(change(**conditions), present, "Board type 'x'")


def test_the_reply_to_a_change_has_content() -> None:
    """304 would say that the caller has the content already, but the condition was one of the change."""
    reply = conditional_response(change(if_none_match="*"), NEW, "text/plain")
    assert (reply.status_code, reply.body) == (200, NEW)


def test_the_first_reply_has_content_and_tag() -> None:
    reply = conditional_response(request(), b"content", "text/plain", headers={"X-More": "1"})
    assert (reply.status_code, reply.body, reply.headers["x-more"]) == (200, b"content", "1")
    assert reply.headers["cache-control"] == IMMUTABLE
    assert reply.headers["vary"] == "Accept"


def test_a_request_with_the_tag_gets_304_without_content() -> None:
    tag = conditional_response(request(), b"content", "text/plain").headers["etag"]
    reply = conditional_response(request(tag), b"content", "text/plain", cache=LIVE)
    assert (reply.status_code, reply.body) == (304, b"")
    assert (reply.headers["etag"], reply.headers["cache-control"]) == (tag, LIVE)


@given(st.binary(max_size=50), st.binary(max_size=50))
def test_tags_differ_exactly_if_the_content_differs(a: bytes, b: bytes) -> None:
    tags = [conditional_response(request(), c, "text/plain").headers["etag"] for c in (a, b)]
    assert (tags[0] == tags[1]) is (a == b)


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        (None, False),
        ("", False),
        ('"a"', True),
        ('W/"a"', True),
        ('"b", "a"', True),
        ('"b",W/"a" ', True),
        ("*", True),
        ('"b"', False),
        ("a", False),
    ],
)
def test_an_if_none_match_header_names_tags(header: str | None, expected: bool) -> None:
    assert matches(header, '"a"') is expected
