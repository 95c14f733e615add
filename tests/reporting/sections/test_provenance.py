"""Times, software and input files."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

from vaoi_station.reporting import StitchedRun
from vaoi_station.reporting.sections.provenance import digest, identity, timings


def test_digest_is_the_first_half_of_the_files_sha_256(tmp_path: Path) -> None:
    path = tmp_path / "board.json"
    path.write_bytes(b"{}")
    assert digest(path) == f"board.json · {hashlib.sha256(b'{}').hexdigest()[:16]}"


def test_input_files_are_named_with_their_digests(stitched: StitchedRun, run: Path) -> None:
    html = identity(stitched).html()
    for name in ("recording.json", "calibration.json", "board.json"):
        assert digest(run / name) in html
    assert "<dt>reference</dt><dd>none</dd>" in html


def test_unknown_values_are_reported_as_such(stitched: StitchedRun) -> None:
    calibration = stitched.opened.calibration.model_copy(update={"created": None, "working_distance_mm": None})
    html = identity(replace(stitched, opened=replace(stitched.opened, calibration=calibration))).html()
    assert "not stated" in html
    assert "not known" in html


def test_every_task_and_stage_has_a_time(stitched: StitchedRun) -> None:
    rows = timings(stitched).html().count("<tr>") - 1
    assert rows == len(stitched.task_ms) + len(stitched.result.quality["timings_ms"])
