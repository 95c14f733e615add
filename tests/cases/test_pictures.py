"""Pictures and heights of recorded cases within the figures of docs/measured, by the program that knows the truth.

`tests/run` has a short form; with VAOI_LONG=1 further cases are filmed.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cases.heights import errors, measure
from tests.conftest import Cases
from tests.needs import FILMS, LONG

HEIGHTS = ("ulx3s-top", "repetitive", "rough", "lights", "hdr-rows") if LONG else ("hdr-rows", "lights")
"""Cases whose heights are pooled."""
MERGED = (("hdr-rows", 0.025), *((("hdr-wide", 0.020),) if LONG else ()))
"""Cases whose frames have several exposures, and the largest rms error of radiance."""
WHOLE: tuple[tuple[str, tuple[str, ...], float], ...] = (
    ("hdr-rows", ("--hdr",), 0.02),
    *((("flat", (), 0.01), ("hdr-wide", ("--hdr",), 0.02)) if LONG else ()),
)
"""Cases whose whole board is one picture, options, and the largest step between blocks, 95 %."""

Stitched = Callable[[str], tuple[str | Path, ...]]


def command(*arguments: str | Path) -> None:
    subprocess.run([sys.executable, "-m", "vaoi_station", *map(str, arguments)], capture_output=True, check=True)


def score(cases: Cases, name: str, kind: str, made: Path) -> dict[str, Any]:
    program = [sys.executable, str(FILMS / "score_pictures.py"), kind, str(cases.with_truth(name)), str(made)]
    figures: dict[str, Any] = json.loads(subprocess.run(program, capture_output=True, check=True).stdout)
    return figures


@pytest.fixture(scope="module")
def stitched(cases: Cases, tmp_path_factory: pytest.TempPathFactory) -> Stitched:
    """Return a function that stitches a case and measures its flat fields, once for all tests.

    It returns the arguments that name case, result and fields.
    """

    @cache
    def make(name: str) -> tuple[str | Path, ...]:
        folder = tmp_path_factory.mktemp(name)
        command("stitch", cases(name), "--out", folder / "result.json")
        command("flatfield", cases(f"{name}-white"), "--dark", cases(f"{name}-black"), "--out", folder / "fields")
        return cases(name), "--result", folder / "result.json", "--flatfield", folder / "fields"

    return make


def test_heights_of_recorded_cases(cases: Cases) -> None:
    each = [errors(measure(cases(name)), cases.truth(name)) for name in HEIGHTS]
    pairs = np.concatenate([measured for _, measured in each])
    assert len(pairs) >= 0.85 * sum(tall for tall, _ in each)
    error_mm, z = np.abs(pairs[:, 0]), pairs[:, 0] / pairs[:, 1]
    assert np.median(error_mm) <= 0.05
    assert np.percentile(error_mm, 90) <= 0.15
    assert 0.6 <= np.sqrt((z**2).mean()) <= 1.6
    assert (np.abs(z) > 3).mean() <= 0.01


@pytest.mark.parametrize(("name", "rms"), MERGED)
def test_merged_pictures_have_the_true_radiance(
    cases: Cases, stitched: Stitched, tmp_path: Path, name: str, rms: float
) -> None:
    command("cut", *stitched(name), "--all", "--hdr", "--format", "npy", "--out", tmp_path / "cut")
    found = score(cases, name, "cut", tmp_path / "cut")
    assert found["rms"] <= rms
    assert found["holes"] <= 0.005
    assert found["decades"] >= 2
    assert name != "hdr-wide" or max(found["rms_by_decade"].values()) <= 0.030


@pytest.mark.parametrize(("name", "more", "most"), WHOLE)
def test_the_whole_board_has_no_visible_step(
    cases: Cases, stitched: Stitched, tmp_path: Path, name: str, more: tuple[str, ...], most: float
) -> None:
    command("mosaic", *stitched(name), *more, "--out", tmp_path / "board.tif")
    found = score(cases, name, "mosaic", tmp_path / "board.tif")
    assert found["step_p95"] <= most
    assert found["tiled"]
    assert found["levels"] > 1
    if name == "flat":
        assert found["shift_rms"] <= 0.05
        assert found["shift_max"] <= 0.2
        assert found["step_max"] <= 0.03
