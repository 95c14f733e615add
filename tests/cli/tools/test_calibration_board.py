from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from vaoi_station.cli import app
from vaoi_station.errors import InputError
from vaoi_station.files.layouts import read_layout

_CAMERA = '[[cameras]]\nname = "{n}"\nwidth = 1392\nheight = 1040\nexposure_us = 250.0\n{more}\n'


def _run(*arguments: str | Path) -> str:
    result = CliRunner().invoke(app, ["calibration-board", *map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def _station(path: Path, nominal: bool) -> Path:
    cameras = "".join(
        _CAMERA.format(n=n, more=f"nominal_center_mm = [{33.14 * n}, 0.0]\nnominal_px_per_mm = 40.0" if nominal else "")
        for n in range(4)
    )
    path.write_text(
        'calibration = "c.json"\nboard_types = "b"\ndata = "d"\n'
        "[line]\nconveyor_mm_s = [0.0, 100.0]\nbarrier_mm = -30.0\nstart_delay_s = 0.25\ntrigger_period_s = 0.12\n"
        f'tail_s = 0.5\nlongest_board_mm = 120.0\n[simulation]\nscenario = "s.toml"\n{cameras}'
    )
    return path


def test_artwork_for_an_array(tmp_path: Path) -> None:
    said = _run(
        "--out", tmp_path, "--cameras", "2", "--pitch-mm", "33", "--field-mm", "34.8x26", "--marks-per-camera", "4x3"
    )
    assert "24 marks for 2 cameras" in said
    assert len(read_layout(tmp_path / "layout.json").marks) == 24
    assert {p.name for p in tmp_path.iterdir()} == {
        "layout.json",
        "calibration-board.svg",
        "calibration-board.pdf",
        "calibration-board.gbr",
        "calibration-board-outline.gbr",
    }


def test_artwork_for_a_configured_station(tmp_path: Path) -> None:
    said = _run("--out", tmp_path / "board", "--config", _station(tmp_path / "station.toml", nominal=True), "--light")
    assert "80 marks for 4 cameras" in said
    layout = read_layout(tmp_path / "board" / "layout.json")
    assert layout.mark.polarity == "light"
    assert max(m.x for m in layout.marks) == pytest.approx(3 * 33.14 + 13.4, abs=1.0)


def test_station_without_nominal_centres_needs_the_other_options(tmp_path: Path) -> None:
    config = _station(tmp_path / "station.toml", nominal=False)
    with pytest.raises(InputError, match="--pitch-mm, --field-mm must be given"):
        _run("--out", tmp_path, "--config", config)
    _run("--out", tmp_path / "a", "--config", config, "--pitch-mm", "33", "--px-per-mm", "40")
    _run("--out", tmp_path / "b", "--cameras", "1", "--field-mm", "40×30")


def test_artwork_fits_the_view_of_the_finest_camera(tmp_path: Path) -> None:
    config = _station(tmp_path / "station.toml", nominal=True)
    # The first camera sees less than the others.
    config.write_text(config.read_text().replace("nominal_px_per_mm = 40.0", "nominal_px_per_mm = 44.0", 1))
    _run("--out", tmp_path / "fine", "--config", config)
    _run("--out", tmp_path / "given", "--config", config, "--px-per-mm", "44")
    assert read_layout(tmp_path / "fine" / "layout.json") == read_layout(tmp_path / "given" / "layout.json")


@pytest.mark.parametrize("field", ["34", "0x3", "ax3", "3..1x2"])
def test_malformed_sizes_are_refused(tmp_path: Path, field: str) -> None:
    with pytest.raises(InputError, match="two numbers above 0"):
        _run("--out", tmp_path, "--cameras", "2", "--pitch-mm", "33", "--field-mm", field)
