from __future__ import annotations

import json
import subprocess
import sys

import pytest
from typer.testing import CliRunner, Result

from vaoi_station.cli import app
from vaoi_station.errors import InputError


def vaoi_plan(*options: str) -> Result:
    return CliRunner().invoke(app, ["plan", *options])


def test_figures_of_the_paper_as_json() -> None:
    result = vaoi_plan("--example", "paper", "--json")
    assert result.exit_code == 0
    document = json.loads(result.stdout)
    assert document["requirements"]["width_mm"] == 400
    assert {c["name"] for c in document["constraints"] if c["ok"] is False} == {"cameras", "frame rate"}
    assert all("margin" in c for c in document["constraints"])
    figures = {f["name"]: f for f in document["paper"]}
    assert {name: f["paper"] for name, f in figures.items()} == {
        "cameras needed": 12,
        "focal length at d_max": 77.7,
        "distance for the 75 mm lens": 483,
        "f-number": None,
        "longest exposure": 250,
        "lowest frame rate": 8,
        "data rate": 1111.8,
        "capture duration": 5,
    }
    for name in ("focal length at d_max", "distance for the 75 mm lens", "longest exposure", "data rate"):
        assert figures[name]["computed"] == pytest.approx(figures[name]["paper"], rel=1e-3)


def test_figures_of_the_paper_as_text() -> None:
    text = vaoi_plan("--example", "paper").stdout
    for figure in (
        "77.7 mm",
        "483 mm",
        "250 µs",
        "8.00 frames/s",
        "1111.8 Mbit/s",
        "12.07",
        "8.08",
        "VIOLATED",
        "open",
    ):
        assert figure in text


def test_missing_requirements_are_named_by_their_options() -> None:
    result = vaoi_plan("--width-mm", "200", "--sensor-px-h", "2448")
    assert isinstance(result.exception, InputError)
    assert "--resolution-px-per-mm, --speed-mm-s, --sensor-px-v" in str(result.exception)
    assert "--width-mm" not in str(result.exception)


def test_help_loads_nothing_heavy() -> None:
    """`vaoi --help` must answer at once: the commands import what they need when they run."""
    code = (
        "import sys, vaoi_station.cli\n"
        "print(sorted({m.split('.')[0] for m in sys.modules} & {'numpy', 'cv2', 'pydantic', 'fastapi', 'uvicorn'}))"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert loaded.stdout.strip() == "[]"
