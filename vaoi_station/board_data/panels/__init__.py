"""Panels, several boards in one piece: read from step-and-repeat, stated by the user, or recognised by equal copies."""

from __future__ import annotations

from vaoi_station.board_data.panels.copies import with_copies
from vaoi_station.board_data.panels.grid import Grid, repeated
from vaoi_station.board_data.panels.layout import laid_out
from vaoi_station.board_data.panels.step_and_repeat import Repeat, Step, note_on_panels, panel_of

__all__ = ["Grid", "Repeat", "Step", "laid_out", "note_on_panels", "panel_of", "repeated", "with_copies"]
