"""Lossless compression of frames: linear prediction, and a Huffman code for each kind of neighbourhood.

The noise of a sensor is most of what a frame is: its entropy bounds every method. Here the weights of the prediction
are fitted to each frame, because weights that average noise away leave less of it than fixed ones.
"""

from vaoi_station.plant.archive.frames.frame_codec import decode_frame, encode_frame

__all__ = ["decode_frame", "encode_frame"]
