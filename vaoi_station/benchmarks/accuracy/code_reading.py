"""Measure how many of the twin's printed codes are read, by the size of their modules.

Every view is one frame of a small board with one code. Blur, brightness, rotation, tilt of camera and board, kind and
polarity of the code are random; motion blur, shot noise and vignetting are those of the twin.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from vaoi_station.geometry.transforms import apply
from vaoi_station.identity.code_reader import read_codes
from vaoi_station.model import BoardReading, Status, Stitch
from vaoi_station.simulation import Scenario, Twin
from vaoi_station.simulation.passage import Passage

PX_PER_MM = 20.0
MODULES_PX = (2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0)
_BOARD_MM = 15.0
_FRAME_PX = 400


@dataclass(frozen=True)
class CodeRates:
    """How many views of codes with modules of one size were read."""

    module_px: float
    views: int
    read: int
    wrong: int
    """Views in which a text was read that is not that of the code."""
    off_mm: float
    """Largest error of the place of a code that was read."""
    ms: float
    """Mean time for a view."""

    def line(self) -> str:
        """Return the figures as one line of text."""
        share = 100 * self.read / self.views
        return (
            f"module {self.module_px:4.1f} px: {self.read} of {self.views} read ({share:.1f} %), {self.wrong} wrong, "
            f"place within {self.off_mm:.3f} mm, {self.ms:.0f} ms"
        )


def measure_code_reading(
    views: int, modules_px: Sequence[float] = MODULES_PX, report: Callable[[str], None] = lambda _: None
) -> list[CodeRates]:
    """Read codes in `views` views for each size of modules."""
    rates = []
    for module_px in modules_px:
        rates.append(_rates(module_px, views))
        report(rates[-1].line())
    return rates


def document(rates: Sequence[CodeRates]) -> dict[str, Any]:
    """Return the figures as a JSON object."""
    return {"px_per_mm": PX_PER_MM, "modules": [asdict(r) for r in rates]}


def _rates(module_px: float, views: int) -> CodeRates:
    read = wrong = 0
    off_mm = took_s = 0.0
    for passage in _boards(module_px, views):
        [text] = passage.code_texts
        row = _best_row(passage)
        pixels = passage.frame(0, row)
        began_s = time.perf_counter()
        found = _read(passage, row, pixels)
        took_s += time.perf_counter() - began_s
        right = [code for code in found.codes if code.text == text]
        read += bool(right)
        wrong += len(right) < len(found.codes)
        middle = passage.twin.board_type.identity
        assert middle is not None
        off_mm = max([off_mm, *(float(np.hypot(*np.subtract(c.center, middle.places[0].center))) for c in right)])
    return CodeRates(module_px, views, read, wrong, round(off_mm, 4), round(1000 * took_s / views, 1))


def _boards(module_px: float, views: int) -> Iterator[Passage]:
    """Yield passages of boards, each of a scenario with other random conditions."""
    for view in range(views):
        g = np.random.default_rng([7060, round(10 * module_px), view])
        code = {
            "x_mm": _BOARD_MM / 2 + g.uniform(-0.05, 0.05),
            "y_mm": _BOARD_MM / 2 + g.uniform(-0.05, 0.05),
            "module_mm": module_px / PX_PER_MM,
            "symbology": "qr" if g.random() < 0.25 else "datamatrix",
            "turned_deg": g.uniform(0, 360),
            "inverted": bool(g.random() < 0.3),
        }
        scenario = {
            "array": {
                "cameras": 1, "width_px": _FRAME_PX, "height_px": _FRAME_PX, "px_per_mm": PX_PER_MM,
                "working_distance_mm": 300.0, "tilt_deg": 0.3, "psf_px": g.uniform(0.5, 1.2),
                "gain": g.uniform(0.4, 1.2), "seed": view,
            },
            "board": {
                "name": "bench", "width_mm": _BOARD_MM, "length_mm": _BOARD_MM, "density": 0.0, "fiducials": (),
                "tilt_mm": tuple(g.uniform(-0.7, 0.7, 2).tolist()), "codes": (code,),
            },
            "line": {"barrier_mm": -15.0, "start_delay_s": 0.05, "period_s": 0.05, "tail_s": 0.3},
        }  # fmt: skip
        yield Twin(Scenario.model_validate(scenario)).passage(view)


def _best_row(passage: Passage) -> int:
    """Return the row in which the middle of the board is closest to the middle of the frame."""
    middle, camera = np.full((1, 2), _BOARD_MM / 2), passage.pinholes[0]
    places = [camera.project(apply(passage.pose(t), middle), 0.0)[0] for t in passage.pulse_times_s]
    return int(np.argmin([np.hypot(*(place - (_FRAME_PX - 1) / 2)) for place in places]))


def _read(passage: Passage, row: int, pixels: Any) -> BoardReading:
    truth = passage.truth()
    stitch = Stitch(
        format="vaoi-stitch",
        version=1,
        method="auto",
        image_matrices=truth["image_matrices"],
        cad_matrix=truth["cad_matrix"],
        row_motion=truth["row_motion"],
        status=Status.OK,
        quality={},
    )
    twin = passage.twin
    return read_codes(twin.board_type, stitch, twin.cameras, lambda _camera, at: pixels if at == row else None)
