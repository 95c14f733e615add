"""Coordinate systems, transforms between them, cameras over the conveyor plane, robust estimation.

Imported by every room that computes; knows nothing of files, frames or devices.
"""

from vaoi_station.geometry.camera import Camera
from vaoi_station.geometry.lens import Lens
from vaoi_station.geometry.transforms import Euclidean, Projective, Similarity, System, apply

__all__ = ["Camera", "Euclidean", "Lens", "Projective", "Similarity", "System", "apply"]
