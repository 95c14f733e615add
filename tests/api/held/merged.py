"""Merged pictures of the station for the REST tests: real merges of frames of an even surface."""

from __future__ import annotations

from typing import Any

from tests.runs.merging.finished_board import Merging
from vaoi_station.hdr.encoding import MergedFormat
from vaoi_station.runs.merging.merged_pictures import MergedChoice, MergeRequest


class HeldMerged:
    """Stands in for `MergedAccess`, of every run that the station has filmed."""

    def __init__(self, station: Any) -> None:
        self._station = station

    def pictures(self, run: str, wanted: MergeRequest) -> tuple[MergedChoice, ...]:
        return self._of(run).access.pictures(run, wanted)

    def image(
        self, run: str, wanted: MergeRequest, k: int | None, format: MergedFormat, *, sigma: bool = False
    ) -> bytes:
        return self._of(run).access.image(run, wanted, k, format, sigma=sigma)

    def _of(self, run: str) -> Merging:
        stitch = self._station.stitch(run)
        return Merging(self._station.types["demo-board"], stitch, self._station.cameras)
