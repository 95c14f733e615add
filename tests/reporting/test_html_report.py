"""The report is one file that loads nothing, and it covers every kind of run."""

from __future__ import annotations

import json
import re
import shutil
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.files import open_recording, write_recording
from vaoi_station.model import Status, Stitch
from vaoi_station.reporting import StitchedRun, restitch
from vaoi_station.reporting.report import render_report
from vaoi_station.stitching.recordings.opening import open_run

SECTIONS = [
    "numbers", "tiles", "frames", "motion", "residuals", "seams", "fiducials", "surface", "components", "timings",
    "identity",
]  # fmt: skip
VOID = {"meta", "br", "link"}


class Reader(HTMLParser):
    """Collects what a browser would: elements, addresses, the text of the data block; checks that tags are closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.count: Counter[str] = Counter()
        self.ids: list[str] = []
        self.addresses: list[str] = []
        self.data = ""
        self.words: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.count[tag] += 1
        given = {k: v or "" for k, v in attrs}
        if "id" in given:
            self.ids.append(given["id"])
        self.addresses += [v for k, v in given.items() if k in ("href", "src", "xlink:href", "action", "srcset")]
        assert not [k for k in given if k.startswith("on")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "script":
            self.data += data
        elif not self.open or self.open[-1] != "style":
            self.words.append(data)


def read(stitched: StitchedRun) -> tuple[Reader, dict[str, Any]]:
    """Parse the report, check the rules for its HTML, and return its parts and numbers."""
    text = render_report(stitched)
    seen = Reader(text)
    assert seen.open == []
    assert len(seen.ids) == len(set(seen.ids))
    inner = {a.removeprefix("#") for a in seen.addresses if a.startswith("#")}
    assert inner <= set(seen.ids)
    assert [a for a in seen.addresses if not a.startswith(("#", "data:image/jpeg;base64,"))] == []
    assert "default-src 'none'" in text
    assert not re.search(r"url\(|@import|NaN|nan\b|\binf\b", re.sub(r"base64,[^\"]+", "", text))
    assert [i for i in seen.ids if i in SECTIONS] == SECTIONS
    data = json.loads(seen.data)
    assert (data["format"], data["version"]) == ("vaoi-report", 1)
    Stitch.model_validate(data["result"])
    return seen, data


def test_run_without_faults_is_shown_completely(stitched: StitchedRun) -> None:
    seen, data = read(stitched)
    assert stitched.result.status is Status.OK
    frames = stitched.cameras * stitched.head.rows
    assert seen.count["image"] == frames
    assert seen.count["use"] == 2 * frames, "in the table, and as a tile"
    links = data["links"]
    assert len(links["a"]) == len(links["residual_px"]) == len(links["weight"]) == len(links["a_px"]) > 200
    assert (
        data["calibration"]["camera_matrices"] == stitched.opened.calibration.model_dump(mode="json")["camera_matrices"]
    )
    text = " ".join(seen.words)
    for name in (f.name for f in stitched.opened.setup.board_type.fiducials):  # type: ignore[union-attr]
        assert name in text
    assert "exaggerated" in text
    assert "run <1> & co" in text, "names that look like markup remain text"
    assert seen.count["script"] == 1


def test_without_a_board_type_frames_and_links_are_shown(run: Path, tmp_path: Path) -> None:
    shutil.copytree(run, tmp_path / "blind")
    (tmp_path / "blind" / "board.json").unlink()
    stitched = restitch(open_run(tmp_path / "blind"))
    seen, data = read(stitched)
    assert stitched.result.status is Status.FAILED
    assert data["board_type"] is None
    assert "no board type was given" in " ".join(seen.words)


@pytest.mark.parametrize("rows", [1, 2])
def test_run_without_a_board_has_a_report(run: Path, tmp_path: Path, rows: int) -> None:
    recording = open_recording(run)
    less = dict.fromkeys(["trigger_times_s", "exposures_us", "lights"])
    head = recording.head.model_copy(update={"rows": rows, "missing": (), **less})
    size = (head.cameras[0].height, head.cameras[0].width)
    belt = np.full(size, 20, np.uint8)
    write_recording(tmp_path / "empty", head, [(i, j, belt) for i in range(len(head.cameras)) for j in range(rows)])
    for name in ("calibration.json", "board.json"):
        shutil.copyfile(run / name, tmp_path / "empty" / name)
    stitched = restitch(open_run(tmp_path / "empty"))
    seen, data = read(stitched)
    assert stitched.result.status is Status.FAILED
    assert "There are no links." in seen.words
    assert data["links"]["a"] == []


def test_other_methods_have_reports(run: Path) -> None:
    features = restitch(open_run(run, method="features"))
    assert read(features)[1]["result"]["method"] == "features"
    fiducials = restitch(open_run(run, method="fiducials"))
    assert "There are no links." in read(fiducials)[0].words
