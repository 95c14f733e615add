"""The part of a good board that is most like one of a run, to be seen beside it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.parts.learned import TaughtBoard
from vaoi_station.parts.patches import ViewClass, same_class
from vaoi_station.parts.registration import Floats32

_MIDDLE = 128.0
"""Grey level of no difference."""


class Neighbour(NamedTuple):
    """A part of a good board: its pictures by view class of the run's part, of equal size and exposure."""

    board: str
    pictures: Mapping[ViewClass, Floats32]


def neighbour(shown: Mapping[ViewClass, NDArray[Any]], boards: Iterable[TaughtBoard], address: str) -> Neighbour | None:
    """Return the part of the good board that is most like the pictures of a part; None if no board shows it."""
    best: tuple[float, Neighbour] | None = None
    for board in boards:
        known, found, alike = board.views(address), dict[ViewClass, Floats32](), list[float]()
        for view, picture in shown.items():
            for other, patch in known.items():
                if same_class(view, other):
                    size = picture.shape[1], picture.shape[0]
                    same = cv2.resize(patch.astype(np.float32), size, interpolation=cv2.INTER_AREA)
                    found[view] = np.asarray(same * np.float32(view.exposure / other.exposure))
                    score = cv2.matchTemplate(np.float32(picture), np.float32(same), cv2.TM_CCOEFF_NORMED)
                    alike.append(float(score[0, 0]))
        if found and (best is None or np.mean(alike) > best[0]):
            best = float(np.mean(alike)), Neighbour(board.name, found)
    return None if best is None else best[1]


def as_picture(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Return grey levels as a picture."""
    return np.asarray(np.clip(np.rint(values), 0, 255), np.uint8)


def difference(part: NDArray[Any], good: NDArray[Any]) -> NDArray[np.uint8]:
    """Return by how much a part is brighter than that of a good board, as a picture: equal pixels are grey."""
    return as_picture(_MIDDLE + part.astype(np.float32) - good)
