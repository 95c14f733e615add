from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.calibration.artwork import ArrayDesign, design_board
from vaoi_station.calibration.mark_identification import choose_hypotheses, find_hypotheses, find_rival
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import CameraHead

W, H, R, PITCH = 1392, 1040, 40.0, 33.1
HEADS = tuple(
    CameraHead(width=W, height=H, exposure_us=1.0, nominal_center_mm=(i * PITCH, 0.0), nominal_px_per_mm=R)
    for i in range(3)
)
SIZE = 80.0
OWN = design_board(ArrayDesign(3, PITCH, (W / R, H / R))).places_mm


def _seen(marks: Floats, camera: int, shift: tuple[float, float], turn_deg: float, scale: float = 1.0) -> Floats:
    """All marks as a camera sees them that is off its design, in px; also those outside its frame."""
    t = math.radians(turn_deg)
    turn = np.array([[math.cos(t), -math.sin(t)], [math.sin(t), math.cos(t)]])
    center = np.array([camera * PITCH, 0.0]) + shift
    return np.asarray((marks - center) @ turn.T * R * scale + ((W - 1) / 2, (H - 1) / 2))


def _framed(px: Floats) -> list[int]:
    return [int(k) for k in np.flatnonzero(((px > 60) & (px < (W - 60, H - 60))).all(1))]


@settings(max_examples=30, deadline=None)
@given(
    shift=st.tuples(st.floats(-5, 5), st.floats(-5, 5)),
    turn_deg=st.floats(-4, 4),
    scale=st.floats(0.97, 1.03),
    covered=st.integers(0, 8),
    foreign=st.integers(0, 6),
    seed=st.integers(0, 1000),
)
def test_marks_are_identified_by_their_pattern(
    shift: tuple[float, float], turn_deg: float, scale: float, covered: int, foreign: int, seed: int
) -> None:
    g, px = np.random.default_rng(seed), _seen(OWN, 1, shift, turn_deg, scale)
    inside = _framed(px)
    kept = [int(k) for k in g.permutation(inside)[: max(len(inside) - covered, 5)]]
    seen = np.vstack([px[kept], g.uniform(60, 980, (foreign, 2))])
    best = choose_hypotheses([find_hypotheses(seen, OWN, HEADS[1], 1, SIZE)])[0]
    assert best is not None
    right = {(k, n) for n, k in enumerate(kept)}
    assert right <= {(int(a), int(b)) for a, b in best.pairs} | right
    assert len(right & {(int(a), int(b)) for a, b in best.pairs}) >= len(right) - 1
    assert np.abs(apply(best.similarity, OWN[kept]) - px[kept]).max() < 4


def test_missing_marks_at_the_edge_decide_between_shifts_of_a_grid() -> None:
    x, y = np.arange(7) * 3.5 - 10.5, np.arange(7) * 2.8 - 8.4
    grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    px = _seen(grid, 0, (2.9, 2.2), 1.0)  # more than half a spacing off
    best = choose_hypotheses([find_hypotheses(px[_framed(px)], grid, HEADS[0], 0, SIZE)])[0]
    assert best is not None
    assert [(a, b) for a, b in best.pairs.tolist()] == [(k, n) for n, k in enumerate(_framed(px))]


def test_the_common_offset_of_all_cameras_decides_for_an_ambiguous_grid() -> None:
    x, y = np.arange(-20, 60) * 4.0, np.arange(-20, 20) * 4.0
    grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    options = []
    for camera, shift in enumerate([(1.4, 0.3), (1.8, -0.1), (2.15, 0.2)]):  # the last is nearer to a wrong one
        px = _seen(grid, camera, shift, 0.3)
        options.append(find_hypotheses(px[_framed(px)], grid, HEADS[camera], camera, SIZE))
    best = choose_hypotheses(options)
    shifts = [h.offset_mm for h in best if h is not None]
    assert np.abs(np.array(shifts) - [(1.4, 0.3), (1.8, -0.1), (2.15, 0.2)]).max() < 0.02
    assert best[0] is not None
    other = find_rival(options[0], best[0])
    assert other is not None
    assert np.hypot(*(other.offset_mm - best[0].offset_mm)) > 3.9


def test_without_marks_there_is_no_hypothesis() -> None:
    assert find_hypotheses(np.zeros((0, 2)), OWN, HEADS[0], 0, SIZE) == ()
    assert find_hypotheses(np.array([[600.0, 500], [700, 700]]), OWN + 500, HEADS[0], 0, SIZE) == ()
    assert choose_hypotheses([()]) == [None]


def test_the_designed_board_is_unambiguous() -> None:
    px = _seen(OWN, 1, (1.0, -2.0), 2.0)
    options = find_hypotheses(px[_framed(px)], OWN, HEADS[1], 1, SIZE)
    assert find_rival(options, options[0]) is None
