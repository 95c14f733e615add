"""The compiled search for the frames that show components."""

from __future__ import annotations

import pickle
import subprocess
import sys
from typing import Any

import numpy as np

from vaoi_station.model import Stitch

BENT = (0.012, 0.001)


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
    assert loaded == "{'upright': 1, '_search': 1}"
