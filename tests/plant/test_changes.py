"""The comparison of former and new results."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from vaoi_station import RecordedRun, StitchedRun
from vaoi_station.plant.changes import Changes, compare, render_changes
from vaoi_station.plant.tables import RunKey, result_tables, write_tables


def test_the_displaced_camera_comes_first_with_its_size(changes: Changes) -> None:
    first, *others = changes.cameras
    assert (first.station, first.camera) == ("line 1", 1)
    # Two runs are compared, one of which has not changed: the mean is half of 0.2 px.
    assert first.runs == 2
    assert first.size_px == pytest.approx(0.1, abs=0.01)
    assert first.y_px == pytest.approx(-0.1, abs=0.01), "the picture lies higher than the calibration says"
    assert all(camera.size_px < 0.7 * first.size_px for camera in others)


def test_runs_without_a_former_result_are_counted_apart(changes: Changes) -> None:
    assert (changes.runs, changes.only_new) == (2, 1)
    assert {b.run for b in changes.boards} == {"r0", "r1"}
    unchanged = next(b for b in changes.boards if b.run == "r0")
    assert (unchanged.changed, unchanged.worst_px, unchanged.former) == (0, 0.0, unchanged.new)


def test_components_are_counted_over_their_runs(changes: Changes) -> None:
    assert {c.runs for c in changes.components} == {2}
    assert changes.changed_components == sum(c.changed > 0 for c in changes.components)
    assert sum(count for _, _, count in changes.verdicts) == 2


def test_cameras_without_a_sigma_are_not_counted_as_changed(
    board: RecordedRun, stitched: StitchedRun, tmp_path: Path
) -> None:
    runs = []
    for name in ("former", "new"):
        key = RunKey("line 1", "r0", "2026-11-01T10:00:00Z", "small")
        tables = result_tables(key, name, stitched.result, board.board_type, stitched.recording.head)
        for axis in "xy":
            tables["cameras"][f"sigma_{axis}_px"] = [None] * 3
        runs.append(tables)
    write_tables(tmp_path / "tables", runs)
    changes = compare(tmp_path / "tables")
    assert [(camera.runs, camera.changed, camera.sigma_px) for camera in changes.cameras] == [(1, 0, None)] * 3
    assert "None of 1" not in render_changes(changes, [], [])


def test_the_report_names_what_changed_and_what_was_left_out(changes: Changes) -> None:
    page = render_changes(changes, [("method", "auto")], ["run r9: blob <x> is missing."])
    assert "default-src 'none'" in page
    assert not re.search(r'(src|href)="(?!#)', page), "nothing is loaded"
    assert "run r9: blob &lt;x&gt; is missing." in page
    cameras = page.split('id="cameras"')[1].split("</section>")[0]
    assert cameras.index(">line 1</td><td>1<") < cameras.index(">line 1</td><td>0<"), "the displaced camera is first"
    data = json.loads(page.split('id="changes">')[1].split("</script>")[0])
    assert data["runs"] == 2
