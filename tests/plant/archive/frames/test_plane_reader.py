"""Parts are taken one after the other, and none beyond the end."""

from __future__ import annotations

import pytest

from vaoi_station.plant.archive.frames.plane_reader import PlaneReader


def test_parts_follow_each_other_up_to_the_end() -> None:
    reader = PlaneReader(b"abcdef")
    assert [reader.take(2), reader.take(0), reader.take(4)] == [b"ab", b"", b"cdef"]
    with pytest.raises(ValueError, match="shorter than its head says"):
        reader.take(1)
