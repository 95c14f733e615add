"""One small recording with its result, shared by the commands that read them."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def case(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A recording with its truth, and its result."""
    from typer.testing import CliRunner

    from vaoi_station.cli import app

    folder = tmp_path_factory.mktemp("small")
    for command in (
        ["simulate", "small", "--out", str(folder / "run")],
        ["stitch", str(folder / "run"), "--out", str(folder / "result.json")],
    ):
        assert CliRunner().invoke(app, command).exit_code == 0
    return folder / "run", folder / "result.json"
