"""Reading pictures from replies."""

from __future__ import annotations

import io
from typing import Any

import cv2
import numpy as np

RUNS = "/api/v1/runs"


def picture(answer: Any) -> np.ndarray:
    """Return the pixels of a reply in any format."""
    kind = answer.headers["content-type"]
    if kind == "application/octet-stream":
        size = [int(answer.headers[f"x-image-{n}"]) for n in ("height", "width")]
        return np.frombuffer(answer.content, answer.headers["x-image-dtype"]).reshape(size)
    if kind == "application/x-npy":
        return np.asarray(np.load(io.BytesIO(answer.content)))
    return np.asarray(cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_UNCHANGED))
