"""`python -m vaoi_station.plant.capacity` prints figures and a table of waits."""

from __future__ import annotations

import typer
from typer.testing import CliRunner

from vaoi_station.plant.capacity.__main__ import main


def test_figures_and_waits_are_printed() -> None:
    app = typer.Typer()
    app.command()(main)
    done = CliRunner().invoke(app, ["--frames", "1e6", "--runs", "100", "--workers", "4"])
    assert done.exit_code == 0, done.output
    assert "archive_tb" in done.output
    rows = [line for line in done.output.splitlines() if line.startswith("| ") and "%" in line]
    assert [row.split()[1] for row in rows[-3:]] == ["2", "4", "8"]
