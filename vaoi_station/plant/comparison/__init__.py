"""New results compared with the former ones: what changed by more than its σ, by board, camera and component."""

from vaoi_station.plant.comparison.change_report import render_changes, write_changes
from vaoi_station.plant.comparison.changes import Changes, compare

__all__ = ["Changes", "compare", "render_changes", "write_changes"]
