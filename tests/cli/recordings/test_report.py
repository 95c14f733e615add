"""`vaoi report`: a file, a bundle, or both."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from vaoi_station.cli import app
from vaoi_station.errors import InputError, NotFoundError


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("report") / "run"
    done = CliRunner().invoke(app, ["simulate", "small", "--out", str(out)])
    assert done.exit_code == 0, done.output
    return out


def test_report_is_one_file(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "r.html"
    done = CliRunner().invoke(app, ["report", str(run), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert done.output.strip() == f"ok: {out}"
    assert out.read_text().startswith("<!doctype html>")


def test_default_is_the_working_directory(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(app, ["report", str(run), "--method", "features"]).exit_code == 0
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


def test_bundle_can_be_stitched_and_reported_again(run: Path, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    done = CliRunner().invoke(app, ["report", str(run), "--bundle", str(kept)])
    assert done.exit_code == 0, done.output
    assert f"vaoi stitch {kept} --method auto --out again.json" in done.output
    again = CliRunner().invoke(app, ["stitch", str(kept), "--out", str(tmp_path / "again.json")])
    assert again.exit_code == 0
    both = ["report", str(kept), "--out", str(tmp_path / "r.html"), "--bundle", str(tmp_path / "second")]
    assert CliRunner().invoke(app, both).exit_code == 0
    assert (tmp_path / "r.html").is_file()
    refused = CliRunner().invoke(app, ["report", str(run), "--bundle", str(kept)])
    assert isinstance(refused.exception, InputError)


def test_directory_without_a_recording_is_refused(tmp_path: Path) -> None:
    assert isinstance(CliRunner().invoke(app, ["report", str(tmp_path)]).exception, NotFoundError)


def test_the_expected_rotation_is_an_option(run: Path, tmp_path: Path) -> None:
    """The board lies upright: expected upside down, it is not found."""
    done = CliRunner().invoke(app, ["report", str(run), "--out", str(tmp_path / "r.html"), "--rotation", "180"])
    assert done.output.startswith("failed: ")
