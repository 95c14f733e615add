"""`vaoi dataset`: exit codes, and what is named on stderr."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from vaoi_station.plant.archive import Archive


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--verdict", "fine"), "--verdict is 'fine'"),
        (("--splits", "train=2"), "--splits is 'train=2'"),
        (("--limit", "0"), "limit is 0"),
    ],
)
def test_wrong_options_are_named(
    vaoi: Callable[..., Any], archive: Archive, tmp_path: Path, options: tuple[str, ...], text: str
) -> None:
    done = vaoi("dataset", archive.url, "--out", tmp_path / "out", *options)
    assert (done.code, text in done.err) == (2, True), done.err
    assert not (tmp_path / "out").exists()


def test_runs_of_other_verdicts_are_counted(vaoi: Callable[..., Any], archive: Archive, tmp_path: Path) -> None:
    done = vaoi("dataset", archive.url, "--components", "C*,R*", "--out", tmp_path / "out", "--format", "webdataset")
    assert done.code == 0, done.err
    assert "0 crops of 0 runs" in done.out
    assert "1 runs have another verdict than ok" in done.out
