"""Photometry: grey levels of frames → linear radiance with its standard deviation, and the merge of several exposures.

Radiance is (grey − dark) / (flat · exposure · gain), in 8-bit grey levels per µs at gain 1 (frames of 16 bits count in
the same unit). The flat fields have mean 1 over all cameras and lights, so that a white target has one radiance for
all of them. Without flat fields the flat is 1, and radiance of different cameras differs as their lenses do.
"""

from vaoi_station.photometry.flat_fields import FieldMaps, FlatFields
from vaoi_station.photometry.merge import merge
from vaoi_station.photometry.noise import NoiseModel, noise_from_frames
from vaoi_station.photometry.radiance import Radiance, Taken, to_radiance

__all__ = [
    "FieldMaps",
    "FlatFields",
    "NoiseModel",
    "Radiance",
    "Taken",
    "merge",
    "noise_from_frames",
    "to_radiance",
]
