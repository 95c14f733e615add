"""Parts of frames by byte range."""

from __future__ import annotations

from typing import Any

import pytest

from tests.api.held.pictures import RUNS

FRAME = f"{RUNS}/r000001/frames/0/0?format=raw"
SIZE = 320 * 240


@pytest.mark.parametrize(
    ("asked", "start", "end"),
    [
        ("bytes=0-319", 0, 320),
        ("bytes=320-", 320, SIZE),
        ("bytes=-5", SIZE - 5, SIZE),
        ("bytes=76799-99999", 76799, SIZE),
    ],
)
def test_some_bytes_of_a_frame(shared_client: Any, asked: str, start: int, end: int) -> None:
    whole = shared_client.get(FRAME)
    assert whole.headers["accept-ranges"] == "bytes"
    part = shared_client.get(FRAME, headers={"Range": asked})
    assert part.status_code == 206
    assert part.content == whole.content[start:end]
    assert part.headers["content-range"] == f"bytes {start}-{end - 1}/{SIZE}"
    assert part.headers["x-image-stride"] == "320"
    assert part.headers["etag"] == whole.headers["etag"]


@pytest.mark.parametrize("asked", ["bytes=5-1", "bytes=0-1,5-9", "lines=0-1", "bytes=-", "bytes=x"])
def test_ranges_that_are_not_understood_give_the_whole(shared_client: Any, asked: str) -> None:
    answer = shared_client.get(FRAME, headers={"Range": asked})
    assert (answer.status_code, len(answer.content)) == (200, SIZE)


def test_a_range_behind_the_end_is_refused(shared_client: Any) -> None:
    answer = shared_client.get(FRAME, headers={"Range": "bytes=76800-"})
    assert (answer.status_code, answer.json()["code"]) == (416, "range-not-satisfiable")
    assert answer.headers["content-range"] == f"bytes */{SIZE}"


def test_a_range_of_other_bytes_gives_the_whole(shared_client: Any) -> None:
    tag = shared_client.get(FRAME).headers["etag"]
    for given, status in ((tag, 206), ('"another"', 200), (f"W/{tag}", 200)):
        answer = shared_client.get(FRAME, headers={"Range": "bytes=0-9", "If-Range": given})
        assert answer.status_code == status
    again = shared_client.get(FRAME, headers={"Range": "bytes=0-9", "If-None-Match": tag})
    assert again.status_code == 304
