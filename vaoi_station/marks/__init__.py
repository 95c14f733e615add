"""Fiducial marks: their artwork, finding look-alikes in a frame, and their place to a few hundredths of a pixel."""

from vaoi_station.marks.candidate_search import find_candidates
from vaoi_station.marks.subpixel_localisation import Mark, locate_mark

__all__ = ["Mark", "find_candidates", "locate_mark"]
