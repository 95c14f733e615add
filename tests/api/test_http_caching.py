"""ETags and conditional requests."""

from __future__ import annotations

from contextlib import nullcontext

import pytest
from fastapi import Request

from vaoi_station.api.http_caching import (
    ChangedError,
    require_unchanged,
    tag_of,
)


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
