"""The digital twin: the world of a scenario and the passages of its boards."""

from __future__ import annotations

from vaoi_station.simulation.passage import Passage
from vaoi_station.simulation.world import World


class Twin(World):
    """The digital twin of one scenario: its world, and the passages of its boards, which give frames and truth."""

    def passage(self, board_number: int) -> Passage:
        """Return the passage of board `board_number`, counted from 0."""
        return Passage(self, board_number)
