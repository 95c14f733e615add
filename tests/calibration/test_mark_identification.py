from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.calibration.artwork import ArrayDesign, design_board
from vaoi_station.calibration.blank_ground import BlankGround
from vaoi_station.calibration.mark_identification import find_hypotheses
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
    best = find_hypotheses(seen, OWN, HEADS[1], 1, SIZE)[0]
    right = {(k, n) for n, k in enumerate(kept)}
    assert right <= {(int(a), int(b)) for a, b in best.pairs} | right
    assert len(right & {(int(a), int(b)) for a, b in best.pairs}) >= len(right) - 1
    assert np.abs(apply(best.similarity, OWN[kept]) - px[kept]).max() < 4


def test_missing_marks_at_the_edge_decide_between_shifts_of_a_grid() -> None:
    x, y = np.arange(7) * 3.5 - 10.5, np.arange(7) * 2.8 - 8.4
    grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    px = _seen(grid, 0, (2.9, 2.2), 1.0)  # more than half a spacing off
    best = find_hypotheses(px[_framed(px)], grid, HEADS[0], 0, SIZE)[0]
    assert [(a, b) for a, b in best.pairs.tolist()] == [(k, n) for n, k in enumerate(_framed(px))]


class _Hidden(BlankGround):
    """A frame of which the left part may hide marks."""

    def __init__(self, width_px: float) -> None:
        blank = np.ones((H, W), np.bool_)
        blank[:, : int(width_px)] = False
        super().__init__(blank, 1)


def test_hidden_marks_speak_less_against_an_assignment_than_marks_missing_on_blank_ground() -> None:
    """A dark strip over two columns of a plain grid: shifted by two spacings, the layout explains all that is seen."""
    x, y = np.arange(7) * 3.48 - 10.44, np.arange(7) * 2.77 - 8.32
    grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    px = _seen(grid, 0, (0.15, 0.1), 0.2)
    seen = [k for k in _framed(px) if px[k, 0] > 480]
    best, *others = find_hypotheses(px[seen], grid, HEADS[0], 0, SIZE, _Hidden(480))
    assert [(a, b) for a, b in best.pairs.tolist()] == [(k, n) for n, k in enumerate(seen)]
    shifted = [h for h in others if h.offset_mm[0] < -6 and len(h.pairs) == len(best.pairs)]
    assert shifted
    assert best.score > max(h.score for h in shifted) + 4
