"""stitching: the panorama pipeline of OpenCV in its affine variant for scans, up to the cameras, without blending.

It takes no nominal positions and matches all pairs of frames.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from stitching import AffineStitcher
from stitching.images import Images

from ..adapter import Setting
from ..strip import Floats, Matrices, Strip

PACKAGES = ("stitching", "opencv-python", "numpy")
_SIFT: dict[str, Any] = {"detector": "sift", "medium_megapix": 1.5, "nfeatures": 2000}
"""Features at full size: the default of 0.6 megapixels reduces our frames by a third."""
SETTINGS = {
    "default": Setting(),
    "SIFT, full size": Setting({**_SIFT, "nfeatures": 500}, ("plain", "yaw")),
    "SIFT, full size, nfeatures=2000": Setting(_SIFT),
    "SIFT, full size, nfeatures=5000": Setting({**_SIFT, "nfeatures": 5000}, ("parts", "line")),
    "SIFT, full size, nfeatures=2000, no adjuster": Setting({**_SIFT, "adjuster": "no"}, ("plain", "yaw")),
    "SIFT, full size, nfeatures=2000; its matches chained by us": Setting(
        {**_SIFT, "chained_here": True}, as_it_is=False
    ),
}


def prepare(strip: Strip, directory: Path) -> list[NDArray[np.uint8]]:
    """Return frames as BGR images."""
    cv2.setNumThreads(1)
    return [cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR) for frame in strip.frames]


def place(images: list[NDArray[np.uint8]], *, chained_here: bool = False, **options: Any) -> Matrices:
    """Return mosaic_from_frame of all frames; those that the stitcher leaves out of the panorama are None.

    OpenCV's affine estimator (and its adjuster, which starts there) multiplies the matrices of a chain in reverse:
    R_from · H, where H · R_from would map a point from frame to frame. Shifts commute, rotations do not.
    `chained_here` multiplies in the right order from the same matches, which separates this error from the quality of
    the features.
    """
    stitcher = AffineStitcher(**options)
    stitcher.images = Images.of(images, stitcher.medium_megapix, stitcher.low_megapix, stitcher.final_megapix)
    frames = stitcher.resize_medium_resolution()
    features = stitcher.find_features(frames)
    matches = stitcher.match_features(features)
    kept = [int(k) for k in stitcher.subsetter.subset(stitcher.images.names, features, matches)]
    features = stitcher.subsetter.subset_list(features, kept)
    matches = stitcher.subsetter.subset_matches(matches, kept)
    if chained_here:
        chain = _chained(matches, len(kept))
    else:
        cameras = stitcher.estimate_camera_parameters(features, matches)
        chain = [camera.R for camera in stitcher.refine_camera_parameters(features, matches, cameras)]
    scale = frames[0].shape[1] / images[0].shape[1]
    placed: Matrices = [None] * len(images)
    for index, frame_from_mosaic in zip(kept, chain, strict=True):
        placed[index] = np.linalg.inv(np.asarray(frame_from_mosaic, np.float64)) @ np.diag([scale, scale, 1.0])
    return placed


def _chained(matches: Any, count: int) -> list[Floats]:
    """Chain frame_from_mosaic along a tree of the most confident pairs; the mosaic is the middle frame."""
    pairs = {(m.src_img_idx, m.dst_img_idx): m for m in matches if np.size(m.H) == 9}
    chain = {count // 2: np.eye(3)}
    while len(chain) < count:
        ends = [pair for pair in pairs if pair[0] in chain and pair[1] not in chain]
        a, b = max(ends, key=lambda pair: float(pairs[pair].confidence))
        chain[b] = np.asarray(pairs[a, b].H, np.float64) @ chain[a]
    return [chain[k] for k in range(count)]
