"""The small twin, built once, and its replies and truth."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from vaoi_station.demo.demo_report import DemoReport
from vaoi_station.demo.evaluation import Output, ServiceReplies, evaluate
from vaoi_station.simulation import Passage, Twin, read_scenario, scenario_path

OUTPUT = Output("out", "out/contact-sheet.png", 48, 123, 0.4, 9.0)
RUN: dict[str, Any] = {
    "id": "r1", "board_type": "small", "verdict": "ok", "reasons": [], "cameras": 2, "rows": 6,
    "counts": {"ok": 12, "incomplete": 0, "missing": 0},
    "belt": {"nominal_mm_s": [0.0, 100.0], "measured_mm_s": [0.3, 100.7], "ratio": 1.007},
    "timings": {
        "filming_s": 0.9, "ready_after_last_frame_ms": 61.05, "links_ms": 182.5, "conclude_ms": 39.2,
        "links": 28, "links_while_filming": 23,
    },
}  # fmt: skip
QUALITY: dict[str, Any] = {
    "links": {"rows": {"found": 504, "used": 399}, "neighbours": {"found": 68, "used": 54}},
    "residual_px": {"median": 0.028, "scatter": 0.022, "sigma0": 1.0},
    "fiducials": [{"name": "FID1", "residual_px": [0.03, 0.04]}, {"name": "FID2", "residual_px": None}],
    "cad_sigma_px": 0.044,
    "timings_ms": {"motion": 9.5, "cad": 24.8, "verdict": 3.0},
}


@pytest.fixture(scope="session")
def twin() -> Twin:
    return Twin(read_scenario(scenario_path("small")))


@pytest.fixture
def passage(twin: Twin) -> Passage:
    """The first board of the twin."""
    return twin.passage(0)


Evaluate = Callable[..., DemoReport]


@pytest.fixture
def evaluated(passage: Passage) -> Evaluate:
    """A function that evaluates a run whose positions are the true ones, shifted along x."""

    def evaluated(run: dict[str, Any] | None = None, shift_px: float = 0.0) -> DemoReport:
        places = {ref: [(i, j, x + shift_px, y) for i, j, x, y in v] for ref, v in passage.truth()["views"].items()}
        replies = ServiceReplies(RUN | (run or {}), {"quality": QUALITY, "components": places})
        return evaluate("small", replies, passage, OUTPUT)

    return evaluated
