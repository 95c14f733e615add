"""`vaoi bundle` writes a file and names what is in it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tests.cli.conftest import Result


def test_a_bundle_is_written_once(vaoi: Callable[..., Result], tmp_path: Path) -> None:
    out = tmp_path / "s.tar.gz"
    done = vaoi("bundle", "--config", tmp_path / "none.toml", "--out", out)
    assert done.code == 0
    assert "without pictures, layouts and secrets" in done.out
    assert "station.toml: not available: " in done.err
    assert "there is no such file" in done.err
    assert out.stat().st_size > 500
    assert vaoi("bundle", "--config", tmp_path / "none.toml", "--out", out).code == 2
