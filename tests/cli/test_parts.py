"""`vaoi parts`: what would lose a good board is refused before anything is measured."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from tests.cli.conftest import Result


def test_a_good_board_is_not_overwritten(tmp_path: Path, vaoi: Callable[..., Result]) -> None:
    good = tmp_path / "good.parts"
    good.write_bytes(b"a good board")
    done = vaoi("parts", tmp_path / "case", "--good", good, "--out", good)
    assert done.code == 2
    assert "good.parts: is read by this command and is not overwritten" in done.err
    assert good.read_bytes() == b"a good board"
    result = tmp_path / "good" / "result.json"
    done = vaoi("parts", tmp_path / "case", "--good", result.parent, "--out", result)
    assert "result.json: is read by this command and is not overwritten" in done.err


def test_two_recordings_of_one_name_are_refused(tmp_path: Path, vaoi: Callable[..., Result]) -> None:
    monday, tuesday = tmp_path / "monday" / "1", tmp_path / "tuesday" / "1"
    monday.mkdir(parents=True)
    tuesday.mkdir(parents=True)
    done = vaoi("parts", tmp_path / "case", "--good", monday, "--good", tuesday, "--out", tmp_path / "parts.json")
    assert done.code == 2
    assert "has the same name as another good board" in done.err


def test_a_board_that_is_not_there_is_named_and_a_kept_one_stays(tmp_path: Path, vaoi: Callable[..., Result]) -> None:
    done = vaoi("parts", tmp_path / "case", "--good", tmp_path / "nowhere", "--out", tmp_path / "parts.json")
    assert (done.code, "nowhere: is neither a recording nor a file of --keep" in done.err) == (2, True)
    (tmp_path / "good").mkdir()
    kept = tmp_path / "kept" / "good.parts"
    kept.parent.mkdir()
    kept.write_bytes(b"another board")
    options = ("--good", tmp_path / "good", "--keep", kept.parent, "--out", tmp_path / "parts.json")
    done = vaoi("parts", tmp_path / "case", *options)
    assert (done.code, "good.parts: exists already" in done.err) == (2, True)
    assert kept.read_bytes() == b"another board"


def test_a_recording_is_taught_as_a_good_board_into_a_file_that_parts_are_compared_with(
    tmp_path: Path, vaoi: Callable[..., Result], small_recording: Path
) -> None:
    for wrong in ((small_recording, "--good", "r1"), ("--good", small_recording), ("--out", tmp_path), ()):
        assert vaoi("teach", *wrong).code == 2
    done = vaoi("teach", "--good", small_recording, "--keep", tmp_path)
    kept = tmp_path / f"{small_recording.name}.parts"
    assert (done.code, done.out.endswith(f"part(s) are kept → {tmp_path}\n")) == (0, True), done.err
    assert vaoi("parts", small_recording, "--good", kept, "--out", tmp_path / "parts.json").code == 0
    document = json.loads((tmp_path / "parts.json").read_text())
    assert document["remark_codes"] == ["few-good-boards", "own-board"]
    assert all(p["presence"] > 0.5 for p in document["parts"].values() if p["presence"] is not None)
