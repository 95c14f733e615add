from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.calibration.artwork import ArrayDesign, design_board
from vaoi_station.errors import InputError

PAPER = ArrayDesign(12, 33.14, (34.8, 26.0))


@given(
    cameras=st.integers(1, 12),
    overlap=st.floats(1.0, 3.0),
    marks=st.tuples(st.integers(2, 6), st.integers(2, 5)),
    shift=st.tuples(st.floats(-3, 3), st.floats(-3, 3)),
)
def test_every_camera_sees_its_marks_wherever_it_hangs(
    cameras: int, overlap: float, marks: tuple[int, int], shift: tuple[float, float]
) -> None:
    design = replace(PAPER, cameras=cameras, pitch_mm=34.8 / overlap, columns=marks[0], rows=marks[1], mark_mm=1.5)
    board = design_board(design)
    places, half = board.places_mm, (np.array(design.field_mm) - design.mark_mm) / 2
    for i in range(cameras):
        off = np.abs(places - (i * design.pitch_mm + shift[0], shift[1]))
        assert (off <= half + 1e-3).all(1).sum() >= marks[0] * marks[1]
    assert (places > board.low_mm).all()
    assert (places < board.high_mm).all()


def test_marks_keep_apart_and_stand_on_whole_microns() -> None:
    board = design_board(PAPER)
    places = board.places_mm
    assert len(places) == 12 * 20
    apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1)) + 99 * np.eye(len(places))
    assert apart.min() > 1.6 * 2
    assert np.allclose(places * 1000, np.rint(places * 1000), atol=1e-6)
    assert board.layout.mark.width == 0.5


def test_no_view_looks_like_another_or_its_mirror_image() -> None:
    places = design_board(replace(PAPER, cameras=3)).places_mm
    views = [places[20 * i : 20 * i + 20] - (i * PAPER.pitch_mm, 0) for i in range(3)]
    mirrored = [views[0] * way for way in ((-1, 1), (1, -1), (-1, -1))]
    for other in [*views[1:], *mirrored]:
        nearest = np.hypot(*(views[0][:, None] - other[None]).transpose(2, 0, 1)).min(1)
        assert np.median(nearest) > 0.25


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"columns": 12}, "12×4 marks of 2 mm come within"),
        ({"tolerance_mm": 13.0}, "leaves -2.0 mm for marks"),
        ({"columns": 1}, "marks per camera is '1×4'"),
        ({"cameras": 0}, "cameras is 0"),
        ({"pitch_mm": -1.0}, "pitch_mm is -1.0"),
        ({"arm": 0.9}, "arm is 0.9"),
    ],
)
def test_impossible_boards_are_refused(change: dict[str, float], said: str) -> None:
    with pytest.raises(InputError, match=said.replace("(", r"\(")):
        design_board(replace(PAPER, **change))  # type: ignore[arg-type]
