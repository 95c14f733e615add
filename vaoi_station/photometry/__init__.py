"""Photometry: grey levels of frames, their noise and saturation, and the flat fields that turn them into radiance.

Radiance is (grey − dark) / (flat · exposure · gain), in 8-bit grey levels per µs at gain 1 (frames of 16 bits count in
the same unit). The flat fields have mean 1 over all cameras and lights, so that a white target has one radiance for
all of them. Without flat fields the flat is 1, and radiance of different cameras differs as their lenses do.
"""

from vaoi_station.photometry.flat_fields import FieldMaps, FlatFields, WhiteBalance
from vaoi_station.photometry.noise import NoiseModel, Taken, noise_from_frames

__all__ = ["FieldMaps", "FlatFields", "NoiseModel", "Taken", "WhiteBalance", "noise_from_frames"]
