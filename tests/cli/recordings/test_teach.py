"""`vaoi teach` keeps a recording as a reference."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tests.cli.conftest import Result
from vaoi_station.files import open_recording


def test_reference_is_kept_and_never_overwritten(
    vaoi: Callable[..., Result], small_recording: Path, tmp_path: Path
) -> None:
    out = tmp_path / "reference"
    done = vaoi("teach", small_recording, "--out", out)
    assert done.code == 0, done.err
    assert done.out.startswith("ok: standard deviation of positions 0.0")
    assert open_recording(out).head == open_recording(small_recording).head
    refused = vaoi("teach", small_recording, "--out", out)
    assert refused.code == 2
    assert "exists already" in refused.err


def test_absent_recording_is_refused(vaoi: Callable[..., Result], tmp_path: Path) -> None:
    done = vaoi("teach", tmp_path, "--out", tmp_path / "reference")
    assert done.code == 2
    assert "there is no such file" in done.err
    assert not (tmp_path / "reference").exists()


def test_a_board_that_does_not_lie_with_the_given_rotation_is_no_reference(
    vaoi: Callable[..., Result], small_recording: Path, tmp_path: Path
) -> None:
    done = vaoi("teach", small_recording, "--out", tmp_path / "reference", "--rotation", 180)
    assert done.code == 2
    assert "is failed and cannot be a reference" in done.err
    done = vaoi("teach", small_recording, "--out", tmp_path / "reference", "--rotation", 0)
    assert done.code == 0, done.err
    assert open_recording(tmp_path / "reference").head.rotation_deg == 0
