"""Tests of the ring's layout: slots neither overlap nor leave the file."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.ring import (
    BAY_RECORD,
    CAMERA_RECORD,
    HEADER,
    PAGE_BYTES,
    SLOT_RECORD,
    FrameShape,
    RingLayout,
)
from vaoi_station.errors import InputError

shapes = st.builds(FrameShape, st.integers(16, 5000), st.integers(16, 5000), st.sampled_from(["Mono8", "Mono16"]))
layouts = st.builds(
    RingLayout,
    st.integers(1, 6),
    st.integers(1, 9),
    st.lists(shapes, min_size=1, max_size=5).map(tuple),
    st.sampled_from([0, PAGE_BYTES]),
)


@given(layouts)
def test_places_and_slots_are_one_to_one(layout: RingLayout) -> None:
    places = [
        (b, c, k) for b in range(layout.bays) for c in range(layout.cameras) for k in range(layout.slots_per_camera)
    ]
    assert [layout.slot(*p) for p in places] == list(range(layout.slots))
    assert [layout.place(s) for s in range(layout.slots)] == places


@given(layouts)
def test_slots_lie_on_pages_of_their_own_inside_the_file(layout: RingLayout) -> None:
    offsets = [layout.offset(s) for s in range(layout.slots)]
    assert all(o % PAGE_BYTES == 0 for o in offsets)
    assert all(b - a == layout.slot_bytes for a, b in pairwise(offsets))
    assert all(f.nbytes + layout.room_bytes <= layout.slot_bytes for f in layout.frames)
    assert offsets[-1] + layout.slot_bytes == layout.file_bytes


@given(layouts)
def test_tables_do_not_overlap(layout: RingLayout) -> None:
    starts = [0, layout.camera_table, layout.bay_table, layout.slot_table]
    sizes = [
        HEADER.itemsize,
        layout.cameras * CAMERA_RECORD.itemsize,
        layout.bays * BAY_RECORD.itemsize,
        layout.slots * SLOT_RECORD.itemsize,
    ]
    ends = [start + size for start, size in zip(starts, sizes, strict=True)]
    assert all(end <= start for end, start in zip(ends, [*starts[1:], layout.first_slot], strict=True))


@given(layouts, st.integers(1, 2**31), st.integers(0, 2**60))
def test_a_layout_is_read_back_from_its_header(layout: RingLayout, pid: int, ticks: int) -> None:
    header = layout.header(pid, ticks)
    assert RingLayout.read(header, layout.camera_records()) == layout
    assert int(header["file_bytes"][0]) == layout.file_bytes
    assert header.tobytes()[:8] == b"VAOIRING"
    assert len(header.tobytes()) == PAGE_BYTES


def test_impossible_numbers_are_refused() -> None:
    shape = FrameShape(32, 32, "Mono8")
    with pytest.raises(InputError, match="bays"):
        RingLayout(0, 1, (shape,))
    with pytest.raises(InputError, match="no camera"):
        RingLayout(1, 1, ())
    with pytest.raises(InputError, match="pixel_format"):
        FrameShape(32, 32, "RGB8")
    layout = RingLayout(2, 3, (shape,))
    for place in ((2, 0, 0), (0, 1, 0), (0, 0, 3), (-1, 0, 0)):
        with pytest.raises(InputError, match="must be"):
            layout.slot(*place)
    with pytest.raises(InputError):
        layout.place(layout.slots)
