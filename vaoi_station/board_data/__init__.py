"""Read the board data of CAD systems and placement machines, and make board types of it.

Every reader returns the same neutral `Design`: both sides, in mm, y up, as seen from the top. `conversion` makes a
board type of one side of it. Sizes that a file does not state are from a table or guessed, and marked as such.
"""

from __future__ import annotations

from vaoi_station.board_data.conversion import to_board_type
from vaoi_station.board_data.design import Design
from vaoi_station.board_data.panels import Grid
from vaoi_station.board_data.reading import FORMATS, Options, is_exported_run, read_design

__all__ = ["FORMATS", "Design", "Grid", "Options", "is_exported_run", "read_design", "to_board_type"]
