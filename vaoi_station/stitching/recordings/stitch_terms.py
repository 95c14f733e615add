"""What a station knew of line and lights when it stitched a run: with it, the run is stitched again equally."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

from vaoi_station.line_config import ExpectedBoard, Line
from vaoi_station.model import BoardType, Finite, Strict
from vaoi_station.model.board_type import Visibility
from vaoi_station.stitching.board.expectation import Expectation, expectation_at, leading_edge_mm


class StitchTerms(Strict):
    """What the result of a run depends on besides its recording, calibration, board type, method and reference."""

    leading_edge_mm: Finite
    """Expected place of the board's leading edge at the first pulse: its tester coordinate along the motion."""
    conveyor_mm_s: tuple[Finite, Finite]
    """Nominal velocity of the belt."""
    expected_board: ExpectedBoard
    """Where station.toml and board type expect the board otherwise, and its tolerances."""
    visibility: Visibility
    """How much of every component the frames had to show, unless the board type stated something else."""
    channels: dict[str, tuple[int, ...]]
    """LED channels of every light, which the reason for a dark light names."""

    @classmethod
    def of(cls, line: Line, visibility: Visibility, channels: Mapping[str, tuple[int, ...]]) -> Self:
        """Return the terms of runs of a board type, from the line as the board type needs it."""
        return cls(
            leading_edge_mm=leading_edge_mm(line),
            conveyor_mm_s=line.conveyor_mm_s,
            expected_board=line.expected_board,
            visibility=visibility,
            channels=dict(channels),
        )

    def expectation(self, board_type: BoardType) -> Expectation:
        """Return where and how the board is expected; another board type than that of the run may be longer."""
        return expectation_at(self.leading_edge_mm, self.conveyor_mm_s, self.expected_board, board_type)
