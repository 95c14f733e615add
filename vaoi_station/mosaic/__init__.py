"""The whole board as one picture: which frame shows which place, how bright each frame is, and the pixels of any part.

A plan (`plan.py`) is made once for a run, from small copies of all its frames. It divides the board into cells of
16 pixels, and assigns each cell to the frame that sees it most vertically; seams run around bodies and through places
where neighbouring frames agree (`seams.py`). Gains that make frames agree follow from their overlaps (`gains.py`).
With the plan, any part is rendered at any resolution from the few frames that show it (`tiles.py`), so that the
picture of a board never lies in memory as a whole.
"""

from vaoi_station.mosaic.frames import FrameChoice, TakenFrame, choose_frames, distinct_exposures_us
from vaoi_station.mosaic.grid import MosaicGrid
from vaoi_station.mosaic.plan import MosaicPlan, make_plan
from vaoi_station.mosaic.tile_specs import TileRenderer
from vaoi_station.mosaic.tiles import render_tile

__all__ = [
    "FrameChoice",
    "MosaicGrid",
    "MosaicPlan",
    "TakenFrame",
    "TileRenderer",
    "choose_frames",
    "distinct_exposures_us",
    "make_plan",
    "render_tile",
]
