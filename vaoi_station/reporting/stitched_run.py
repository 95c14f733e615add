"""Stitch a recorded run again, and keep everything that a report shows."""

from __future__ import annotations

import time
from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.model import RecordingHead, Stitch
from vaoi_station.reporting.drawing import Thumbnail, thumbnail, thumbnail_width
from vaoi_station.stitching.matching.evidence import Evidence, FrameKey, Links
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.recordings.opening import OpenedRun
from vaoi_station.stitching.recordings.origin import with_origin
from vaoi_station.stitching.work import all_tasks


@dataclass(frozen=True, eq=False)
class FramePair:
    """Two frames between which links were searched, and what the search found."""

    links: Links
    used: int
    """Number of links between the frames that have weight in the adjustment."""
    residual_px: float | None
    """Root mean square residual of the used links; None if there are none."""

    @property
    def a(self) -> FrameKey:
        """The first frame of the pair, as (camera, row)."""
        return self.links.task.a

    @property
    def b(self) -> FrameKey:
        """The second frame of the pair, as (camera, row)."""
        return self.links.task.b or self.links.task.a

    @property
    def score(self) -> float:
        """Mean correlation of the links; 0 without links."""
        return float(self.links.score.mean()) if len(self.links.score) else 0.0


@dataclass(frozen=True, eq=False)
class StitchedRun:
    """A run, its result, and the evidence and intermediate values that led to it."""

    opened: OpenedRun
    evidence: tuple[Evidence, ...]
    result: Stitch
    findings: Findings
    task_ms: dict[str, float]
    """Wall time by kind of task, reading of frames included; times of the conclusion are in `result.quality`."""
    thumbnails: dict[FrameKey, Thumbnail]

    @property
    def head(self) -> RecordingHead:
        """The head of the recording."""
        return self.opened.recording.head

    @property
    def cameras(self) -> int:
        """The number of cameras (the paper's n)."""
        return len(self.head.cameras)

    @cached_property
    def pairs(self) -> tuple[FramePair, ...]:
        """Every pair of frames that was searched for links, in the order of the tasks."""
        f = self.findings
        adjusted, links = f.adjusted, f.problem.links
        # Evidence is found by identity: the adjustment holds the same objects, and arrays cannot be compared with ==.
        number = {id(e): n for n, e in enumerate(links.groups)}
        out = []
        for e in f.links:
            mine = links.group == number.get(id(e), -1)
            # The same threshold as for the counts of used links in `result.quality`.
            used = mine & (adjusted.weight > 0.1) if len(adjusted.weight) else mine[:0]
            px = np.hypot(*adjusted.link_px[used].T) if used.any() else np.zeros(0)
            rms = float(np.sqrt(np.mean(px**2))) if len(px) else None
            out.append(FramePair(e, int(used.sum()), rms))
        return tuple(out)

    @cached_property
    def causes(self) -> dict[FrameKey, tuple[str, str]]:
        """State and cause of every frame whose verdict is not ok, by camera and row."""
        entries = (self.head.model_extra or {}).get("x_verdicts")
        out = dict.fromkeys(self.head.missing, ("missing", "the frame was not delivered"))
        for entry in entries if isinstance(entries, list) else []:
            key, verdict, cause = _entry(entry)
            if key in out:
                out[key] = (verdict, cause or out[key][1])
        return out


def restitch(opened: OpenedRun) -> StitchedRun:
    """Stitch a run again, and keep its evidence, findings and times, and a thumbnail of each frame."""
    head, present = opened.recording.head, opened.present
    width = thumbnail_width(len(present))
    thumbnails: dict[FrameKey, Thumbnail] = {}
    read = opened.recording.frame

    def frame(camera: int, row: int) -> NDArray[Any] | None:
        pixels = read(camera, row)
        # Thumbnails are made while the frame is in memory, so that no file is read and decoded a second time.
        if pixels is not None and (camera, row) not in thumbnails:
            thumbnails[camera, row] = thumbnail(pixels, width)
        return pixels

    times_s = head.motion_times_s()
    runner = opened.runner(frame)
    evidence, task_ms = [], defaultdict[str, float](float)
    for task in all_tasks(present, dict(enumerate(times_s)), opened.setup):
        began_s = time.perf_counter()
        evidence.append(runner.perform(task))
        task_ms[task.kind] += (time.perf_counter() - began_s) * 1e3
    stitch, findings = runner.conclude_with_findings(times_s, present, evidence, head.doubts)
    stitch = with_origin(stitch, opened.recording, opened.calibration, opened.setup.board_type)
    # Frames that no task read still need a thumbnail.
    for key in present:
        if key not in thumbnails:
            frame(*key)
    return StitchedRun(opened, tuple(evidence), stitch, findings, dict(task_ms), thumbnails)


def _entry(entry: Any) -> tuple[FrameKey, str, str]:
    """Read an entry of the recorder's list of frames. This list is an `x_` key of the recording, whose type is not
    checked."""
    if not isinstance(entry, dict):
        return (-1, -1), "", ""
    camera, row = entry.get("camera"), entry.get("row")
    key = (camera, row) if isinstance(camera, int) and isinstance(row, int) else (-1, -1)
    return key, str(entry.get("verdict", "missing")), str(entry.get("cause", ""))
