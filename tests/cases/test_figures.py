"""Figures in the documents equal those of docs/measured/figures.json, and these equal the measured ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.cases.figures import CASES, DOCUMENTS, FIGURES, figures_of, rendered

KNOWN = json.loads(FIGURES.read_text(encoding="utf-8"))
NOISE_PX = 0.003
"""Largest difference between two machines, as compilers reorder sums."""


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda p: p.name)
def test_documents_show_the_figures_of_the_file(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert "<!-- figures: " in text
    assert rendered(text, KNOWN) == text, "run: python -m tests.cases.figures"


def test_every_case_is_in_the_file() -> None:
    assert list(KNOWN) == list(CASES)


@pytest.mark.cases
@pytest.mark.parametrize("name", CASES)
def test_figures_of_the_file_equal_the_measured_ones(cases: Any, name: str) -> None:
    result = cases.stitched(name)
    now = figures_of(result.status, cases.score(name, result), result.quality["cad_sigma_px"])
    assert now["status"] == KNOWN[name]["status"]
    for key in ("rms_px", "sigma_px"):
        assert now[key] == pytest.approx(KNOWN[name][key], abs=NOISE_PX), "run: python -m tests.cases.figures CASES"
    assert now["max_px"] == pytest.approx(KNOWN[name]["max_px"], abs=3 * NOISE_PX)
