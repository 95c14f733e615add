"""Coordinate systems, plane transforms, calibrated cameras over the conveyor plane, and robust estimation.

Pure mathematics: this package uses no files or devices, and knows pictures as arrays only.
"""

from vaoi_station.geometry.camera import Camera
from vaoi_station.geometry.lens import Lens
from vaoi_station.geometry.transforms import Euclidean, Projective, Similarity, System, apply

__all__ = ["Camera", "Euclidean", "Lens", "Projective", "Similarity", "System", "apply"]
