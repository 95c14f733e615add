"""Options of commands that call a running station: a key never stands in the arguments of a process."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from vaoi_station.cli import app
from vaoi_station.cli.station.station_access import credentials_of


def test_the_key_comes_from_a_file_or_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "key").write_text("vaoi_1_a\n")
    monkeypatch.setenv("VAOI_KEY", "vaoi_2_b")
    assert credentials_of(tmp_path / "key", None).key == "vaoi_1_a"
    assert credentials_of(None, tmp_path).key == "vaoi_2_b"
    assert credentials_of(None, tmp_path).ca == tmp_path


def parameters(command: Any, name: str = "vaoi") -> Iterator[tuple[str, str]]:
    """Yield every command below this one, with the name of each of its parameters."""
    for parameter in command.params:
        yield name, parameter.name or ""
    for below, sub in getattr(command, "commands", {}).items():
        yield from parameters(sub, f"{name} {below}")


def test_no_option_takes_a_secret_itself() -> None:
    """All users of a machine can read the arguments of its processes."""
    words = ("key", "secret", "token", "password")
    named = [(c, p) for c, p in parameters(typer.main.get_command(app)) if any(w in p for w in words)]
    assert [(c, p) for c, p in named if not p.endswith("_file")] == []
    assert {c for c, _ in named} >= {"vaoi doctor", "vaoi bundle"}
