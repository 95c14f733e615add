"""Merged pictures of components and regions: frames of several exposures → linear radiance (paper, section 3.5)."""

from vaoi_station.hdr.encoding import tone_map
from vaoi_station.hdr.merging import Exposed, MergedPicture, merge_views

__all__ = ["Exposed", "MergedPicture", "merge_views", "tone_map"]
