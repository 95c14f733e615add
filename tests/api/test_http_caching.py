"""ETags and conditional requests."""

from __future__ import annotations

import pytest
from fastapi import Request
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.api.http_caching import IMMUTABLE, LIVE, conditional_response, matches


def request(if_none_match: str | None = None) -> Request:
    headers = [] if if_none_match is None else [(b"if-none-match", if_none_match.encode())]
    return Request({"type": "http", "headers": headers})


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
