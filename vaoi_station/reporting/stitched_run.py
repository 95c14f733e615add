"""Stitch a recorded run again, and keep everything that a report shows."""

from __future__ import annotations

import base64
import time
from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.files.images import encode_jpeg
from vaoi_station.model import RecordingHead, Stitch
from vaoi_station.pixel_formats import eight_bit_grey
from vaoi_station.stitching.matching.evidence import Evidence, FrameKey, Links
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.recordings.opening import OpenedRun
from vaoi_station.stitching.recordings.origin import with_origin
from vaoi_station.stitching.work import all_tasks

WIDEST_PX, NARROWEST_PX = 240, 40
_ALL_PX = 128 * 96 * 600
"""Limit for the pixels of all thumbnails together, so that the report of any run stays within a few MB."""


@dataclass(frozen=True)
class Thumbnail:
    """A reduced frame as the bytes of a JPEG, with its width and height in px."""

    jpeg: bytes
    width: int
    height: int

    @property
    def uri(self) -> str:
        """The picture as a data URI."""
        return "data:image/jpeg;base64," + base64.b64encode(self.jpeg).decode("ascii")


def thumbnail_width(frames: int) -> int:
    """Return the width in px of each thumbnail. The more frames a run has, the smaller they are."""
    fair = int((_ALL_PX / max(frames, 1) * 4 / 3) ** 0.5)
    return min(max(fair, NARROWEST_PX), WIDEST_PX)


def thumbnail(pixels: NDArray[Any], width: int) -> Thumbnail:
    """Reduce a frame (h, w) or (h, w, 3), 8 or 16 bit, to a width in px, and brighten it. Never enlarge a frame."""
    grey = eight_bit_grey(pixels)
    h, w = grey.shape
    width = min(width, w)
    size = (width, max(round(h * width / w), 1))
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    # Dark frames become visible, but the lower limit of 40 keeps the noise of a black one black.
    gain = 235 / max(float(np.percentile(small, 99.5)), 40.0)
    return Thumbnail(encode_jpeg(cv2.convertScaleAbs(small, alpha=max(gain, 1.0)), 60), *size)


@dataclass(frozen=True, eq=False)
class FramePair:
    """Two frames, as (camera, row), between which links were searched, and what the search found."""

    a: FrameKey
    b: FrameKey
    links: Links
    used: int
    """Number of links between the frames that have weight in the adjustment."""
    residual_px: float | None
    """Root mean square residual of the used links; None if there are none."""


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
        adjusted, links = self.findings.adjusted, self.findings.problem.links
        # Evidence is found by identity: the adjustment holds the same objects, and arrays cannot be compared with ==.
        number = {id(e): n for n, e in enumerate(links.groups)}
        out = []
        for e in self.findings.links:
            # The same threshold as for the counts of used links in `result.quality`.
            used = adjusted.link_px[(links.group == number.get(id(e), -1)) & (adjusted.weight > 0.1)]
            rms_px = float(np.sqrt((used**2).sum(1).mean())) if len(used) else None
            out.append(FramePair(e.task.a, e.task.b or e.task.a, e, len(used), rms_px))
        return tuple(out)

    @cached_property
    def causes(self) -> dict[FrameKey, tuple[str, str]]:
        """State and cause of every frame whose verdict is not ok, by camera and row."""
        out = dict.fromkeys(self.head.missing, ("missing", "the frame was not delivered"))
        # The recorder's list is an `x_` key, whose type is not checked.
        entries = (self.head.model_extra or {}).get("x_verdicts")
        for entry in entries if isinstance(entries, list) else ():
            key = (entry.get("camera"), entry.get("row")) if isinstance(entry, dict) else None
            if key is not None and all(isinstance(n, int) for n in key) and key in out:
                out[key] = str(entry.get("verdict", "missing")), str(entry.get("cause") or out[key][1])
        return out


def restitch(opened: OpenedRun) -> StitchedRun:
    """Stitch a run again, and keep its evidence, findings and times, and a thumbnail of each frame."""
    present, width = opened.present, thumbnail_width(len(opened.present))
    thumbnails: dict[FrameKey, Thumbnail] = {}

    def frame(camera: int, row: int) -> NDArray[Any] | None:
        pixels = opened.recording.frame(camera, row)
        # Thumbnails are made while the frame is in memory, so that no file is read and decoded a second time.
        if pixels is not None and (camera, row) not in thumbnails:
            thumbnails[camera, row] = thumbnail(pixels, width)
        return pixels

    times_s = opened.recording.head.motion_times_s()
    runner = opened.runner(frame)
    evidence, task_ms = [], defaultdict[str, float](float)
    for task in all_tasks(present, dict(enumerate(times_s)), opened.setup):
        began_s = time.perf_counter()
        evidence.append(runner.perform(task))
        task_ms[task.kind] += (time.perf_counter() - began_s) * 1e3
    stitch, findings = runner.conclude_with_findings(times_s, present, evidence, opened.recording.head.doubts)
    stitch = with_origin(stitch, opened.recording, opened.calibration, opened.setup.board_type)
    for key in present:
        if key not in thumbnails:  # no task has read it
            frame(*key)
    return StitchedRun(opened, tuple(evidence), stitch, findings, dict(task_ms), thumbnails)
