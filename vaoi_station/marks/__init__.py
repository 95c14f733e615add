"""Fiducial marks: their artwork, finding look-alikes in a frame, and their place to a few hundredths of a pixel."""

from vaoi_station.marks.locate import Mark, locate
from vaoi_station.marks.search import search

__all__ = ["Mark", "locate", "search"]
