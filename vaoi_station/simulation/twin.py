"""The digital twin: the world of a scenario, and the boards that pass."""

from __future__ import annotations

from vaoi_station.simulation.passage import Passage
from vaoi_station.simulation.world import World


class Twin(World):
    """What camera k sees at time t, for every board of a scenario."""

    def passage(self, board_number: int) -> Passage:
        """Return the passage of board `board_number`, counted from 0."""
        return Passage(self, board_number)
