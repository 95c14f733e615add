"""The report of a comparison: one file that loads nothing, with everything escaped."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

from vaoi_station.plant.comparison import Changes, render_changes, write_changes


def test_the_report_names_what_changed_and_what_was_left_out(changes: Changes, tmp_path: Path) -> None:
    write_changes(tmp_path / "report.html", changes, [("method", "auto")], ["run r9: blob <x> is missing."])
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "default-src 'none'" in page
    assert not re.search(r'(src|href)="(?!#)', page), "nothing is loaded"
    assert "run r9: blob &lt;x&gt; is missing." in page
    cameras = page.split('id="cameras"')[1].split("</section>")[0]
    assert cameras.index(">line 1</td><td>1<") < cameras.index(">line 1</td><td>0<"), "the displaced camera is first"
    data = json.loads(page.split('id="changes">')[1].split("</script>")[0])
    assert data["runs"] == 2


def test_names_cannot_end_an_element(changes: Changes) -> None:
    board = changes.boards[0]._replace(run="</script><script>alert(1)</script>")
    page = render_changes(dataclasses.replace(changes, boards=(board,)), [], [])
    assert "<script>alert" not in page


def test_without_changes_the_head_is_green(changes: Changes) -> None:
    none = dataclasses.replace(changes, runs=2, changed_boards=0)
    assert '<header class="ok">' in render_changes(none, [], [])
