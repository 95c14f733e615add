"""Marks such as fiducials: their shapes, the search for candidates in a frame, and sub-pixel localisation."""

from vaoi_station.marks.candidate_search import find_candidates
from vaoi_station.marks.subpixel_localisation import Mark, locate_mark

__all__ = ["Mark", "find_candidates", "locate_mark"]
