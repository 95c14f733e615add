"""The comparison of former and new results."""

from __future__ import annotations

import json
import re

import pytest

from vaoi_station.plant.changes import Changes, render_changes


def test_the_displaced_camera_comes_first_with_its_size(changes: Changes) -> None:
    first, *others = changes.cameras
    assert (first.station, first.camera) == ("line 1", 1)
    # Two runs are compared, one of which has not changed: the mean is half of 0.2 px.
    assert first.runs == 2
    assert first.size_px == pytest.approx(0.1, abs=0.01)
    assert first.y_px == pytest.approx(-0.1, abs=0.01), "the picture lies higher than the calibration says"
    assert all(camera.size_px < 0.7 * first.size_px for camera in others)


def test_the_report_names_what_changed_and_what_was_left_out(changes: Changes) -> None:
    page = render_changes(changes, [("method", "auto")], ["run r9: blob <x> is missing."])
    assert "default-src 'none'" in page
    assert not re.search(r'(src|href)="(?!#)', page), "nothing is loaded"
    assert "run r9: blob &lt;x&gt; is missing." in page
    cameras = page.split('id="cameras"')[1].split("</section>")[0]
    assert cameras.index(">line 1</td><td>1<") < cameras.index(">line 1</td><td>0<"), "the displaced camera is first"
    data = json.loads(page.split('id="changes">')[1].split("</script>")[0])
    assert data["runs"] == 2
