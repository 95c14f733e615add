"""Crops of components from archived runs, as data sets for training: COCO or WebDataset.

A crop is one upright picture of one component from one frame, with everything that is known about it. Splits are by
board; equal selections give equal bytes.
"""

from vaoi_station.plant.datasets.crops import Crop, CropOptions
from vaoi_station.plant.datasets.session import FORMATS, DatasetSummary, DatasetTerms, Listener, write_dataset
from vaoi_station.plant.datasets.splits import Splits

__all__ = ["FORMATS", "Crop", "CropOptions", "DatasetSummary", "DatasetTerms", "Listener", "Splits", "write_dataset"]
