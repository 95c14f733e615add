"""Pairs of a component and a frame, against the model step by step: C, D_j, pinhole, lens."""

from __future__ import annotations

import pickle
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from vaoi_station.geometry import apply
from vaoi_station.model import Stitch
from vaoi_station.rendering.frame_pairs import Frames, Pairs, Parts, find_pairs

CAMERAS, ROWS = 2, 4
BENT = (0.012, 0.001)
HEIGHT_MM = 1.5


def found(s: Any, *, bare: bool = True, least: float = 0.5, moved_mm: float = 0.0) -> Pairs:
    """Find the pairs of the board's components, whose pictures have one pixel per quarter of a millimetre."""
    n, keys = len(s.board_type.components), np.array([(i, j) for i in range(CAMERAS) for j in range(ROWS)])
    row_from_cad = np.array([d @ s.stitch.cad_matrix for d in s.stitch.row_motion])
    n_i = np.array([c.image_from_row.matrix for c in s.cameras])
    lean = np.array([m @ (*c.foot_mm, 1.0) / c.working_distance_mm for m, c in zip(n_i, s.cameras, strict=True)])
    lens = s.cameras[0].lens
    frames = Frames(
        n_i[keys[:, 0]] @ row_from_cad[keys[:, 1]],
        lean[keys[:, 0]],
        np.array([(c.width_px, c.height_px) for c in s.cameras], dtype=np.float64)[keys[:, 0]],
        np.full(len(keys), 0.0 if lens.ideal else 4.0),
        np.full(len(keys), 12.0),
        keys,
        np.array([c.lens.coefficients for c in s.cameras]),
        np.array([c.lens.shape for c in s.cameras]),
        np.array([not c.lens.ideal for c in s.cameras]),
    )
    center = np.array([c.center for c in s.board_type.components])
    half = np.array([(c.width / 2, c.height / 2) for c in s.board_type.components])
    size, cad_from_crop = np.tile([20.0, 12.0], (n, 1)), np.tile(np.eye(3), (n, 1, 1))
    cad_from_crop[:, 0, 0], cad_from_crop[:, 1, 1] = 0.25, -0.25
    cad_from_crop[:, :2, 2] = center + (-2.375, 1.375)
    inner = np.zeros((n, 2, 2))
    inner[:, 0, 0], inner[:, 1, 1] = half[:, 0], half[:, 1]
    own = np.tile(np.eye(3), (n if moved_mm else 0, 1, 1))
    own[:, 0, 2] = moved_mm
    parts = Parts(center, half, inner, np.full(n, HEIGHT_MM), own, size, cad_from_crop, np.full(n, bare))
    return find_pairs(frames, parts, least)


def square(n: int) -> Any:
    """Return a grid of n × n points over the square from −1 to 1, row by row."""
    t = np.linspace(-1, 1, n)
    return np.stack(np.meshgrid(t, t), -1).reshape(-1, 2)


@pytest.mark.parametrize("lens", [(), BENT])
@pytest.mark.parametrize("moved_mm", [0.0, 0.4])
@pytest.mark.parametrize("bare", [False, True])
def test_pictures_and_footprints_lie_where_the_model_says(make: Any, lens: Any, moved_mm: float, bare: bool) -> None:
    s = make(lens=lens)
    pairs = found(s, bare=bare, moved_mm=moved_mm)
    assert len(pairs.component) > 20
    for n, (k, frame) in enumerate(zip(pairs.component.tolist(), pairs.frame.tolist(), strict=True)):
        camera, row = divmod(frame, ROWS)
        center = np.array(s.board_type.components[k].center) + (moved_mm, 0.0)
        # The centres of the border pixels lie half a pixel, 0.125 mm, inside the footprint of 5 × 3 mm.
        picture = s.raw_px(camera, row, center + square(3) * (2.375, -1.375), HEIGHT_MM)
        np.testing.assert_allclose(pairs.picture_px[n], picture, atol=1e-6)
        corners = square(3)[[0, 2, 8, 6]] * (2.5, 1.5)
        footprint = picture[[0, 2, 8, 6]] if bare else s.raw_px(camera, row, center + corners, HEIGHT_MM)
        np.testing.assert_allclose(pairs.outline_px[n], footprint, atol=1e-6)
        middle = s.cameras[camera].lens.distort(apply(pairs.image_from_crop[n], [(9.5, 5.5)]))
        np.testing.assert_allclose(middle[0], picture[4], atol=1e-6)


@pytest.mark.parametrize("lens", [(), BENT])
@pytest.mark.parametrize("least", [0.0, 0.4, 0.5, 1.0])
def test_frames_that_show_enough_are_found_best_first(make: Any, lens: Any, least: float) -> None:
    s = make(lens=lens)
    pairs = found(s, bare=False, least=least)
    rows: list[list[tuple[float, float, int, int]]] = [[] for _ in s.board_type.components]
    for k, part in enumerate(s.board_type.components):
        for camera, row in np.ndindex(CAMERAS, ROWS):
            grid = s.raw_px(camera, row, part.center + square(9) * (2.5, 1.5), HEIGHT_MM)
            share = float(s.cameras[camera].sees(grid).mean())
            middle = (np.array([s.cameras[camera].width_px, s.cameras[camera].height_px]) - 1) / 2
            off = float(np.hypot(*(grid[40] - middle)) / np.hypot(*middle))
            if share >= max(least, 1e-9):
                rows[k].append((-share, round(off, 6), row, camera))
    expected = [(k, camera, row, -share) for k, own in enumerate(rows) for share, _, row, camera in sorted(own)]
    given = zip(
        pairs.component.tolist(), *(v.tolist() for v in divmod(pairs.frame, ROWS)), pairs.coverage.tolist(), strict=True
    )
    assert list(given) == expected


def test_a_component_beside_all_frames_has_no_pair(make: Any) -> None:
    s = make(components=[{"ref": "far", "center": [900, 900], "width": 5, "height": 3}])
    assert len(found(s).component) == 0


PROGRAM = """
import pickle, sys
from vaoi_station import compiled
from vaoi_station.rendering import Framing, ViewCalculator, frame_pairs

def signatures():
    made = [m for m in compiled._functions if m.py_func.__module__ == frame_pairs.__name__]
    return {m.py_func.__name__: len(m.signatures) for m in made}

frame_pairs.load()
print(signatures())
for board_type, stitch, cameras in pickle.load(sys.stdin.buffer):
    views = ViewCalculator(board_type, stitch, cameras)
    for align in ("cad", "part"):
        framing = Framing(align=align, margin_mm=1, px_per_mm=8, plane="top")
        views.compute_all(board_type.components, framing=framing, min_coverage=1, heights_mm={"U0": 1.0})
    views.compute_all(board_type.components[:1])
    views.compute(board_type.components[0], min_coverage=0.3)
print(signatures())
"""


def test_what_is_loaded_in_advance_is_what_runs_use(make: Any) -> None:
    """A worker would wait for the compiler at the first request whose arguments have other types."""
    boards = [make(), make(lens=BENT, surface=True, side="bottom")]
    moved = np.array(boards[0].stitch.cad_matrix) + [[0, 0, 0.3], [0, 0, 0], [0, 0, 0]]
    own = boards[0].stitch.model_copy(update={"local_matrices": {"U1": moved}})
    runs = [(s.board_type, s.stitch, s.cameras) for s in boards] + [(boards[0].board_type, own, boards[0].cameras)]
    # As from the archive: what was read from a file may be laid out otherwise than what was computed.
    runs.append((boards[0].board_type, Stitch.model_validate_json(own.model_dump_json()), boards[0].cameras))
    done = subprocess.run([sys.executable, "-c", PROGRAM], input=pickle.dumps(runs), check=True, capture_output=True)
    loaded, used = done.stdout.decode().splitlines()
    assert loaded == used
    assert loaded == "{'turn_boxes': 1, 'upright': 1, '_search': 1}"
