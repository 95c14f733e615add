"""The corrected board type: its components, and what else moves with them, moved onto the pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType, Component

Group = Literal["components", "fiducials", "outline"]
_DIGITS = 4
"""Places are rounded to this many decimals of a millimetre."""


@dataclass(frozen=True)
class Move:
    """Mirror x, rotate, scale and shift, in mm, as seen from the top with y up."""

    mirrored: bool
    degrees: float
    scale: float
    middle_mm: tuple[float, float]
    """The middle of the components before the move."""
    shift_mm: tuple[float, float]
    """Displacement of the middle."""

    @staticmethod
    def of(matrix: Floats, middle_mm: Floats) -> Move:
        """Return the move that a similarity (3, 3) makes."""
        mirrored = bool(np.linalg.det(matrix[:2, :2]) < 0)
        (a, c), (b, d) = matrix[0, :2] * (-1 if mirrored else 1, 1), matrix[1, :2] * (-1 if mirrored else 1, 1)
        angle = math.degrees(math.atan2(b - c, a + d))
        shift = apply(matrix, middle_mm) - middle_mm
        scale = math.sqrt(abs(float(np.linalg.det(matrix[:2, :2]))))
        return Move(mirrored, angle, scale, _pair(middle_mm), _pair(shift))

    @property
    def matrix(self) -> Floats:
        """Matrix (3, 3) of the move."""
        a = math.radians(self.degrees)
        turn = self.scale * np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]])
        turn = turn @ np.diag([-1.0 if self.mirrored else 1.0, 1.0])
        out = np.eye(3)
        out[:2, :2], out[:2, 2] = turn, np.add(self.middle_mm, self.shift_mm) - turn @ self.middle_mm
        return out

    def snapped(self, sigma_deg: float, sigma_scale: float) -> Move:
        """Return the move without a scale, and turned by quarters only, where these lie within three sigma."""
        quarter = 90.0 * round(self.degrees / 90)
        return replace(
            self,
            degrees=quarter if abs(self.degrees - quarter) <= 3 * sigma_deg else self.degrees,
            scale=1.0 if abs(self.scale - 1) <= 3 * sigma_scale else self.scale,
        )


def moved_board_type(board: BoardType, move: Move, groups: tuple[Group, ...]) -> BoardType:
    """Return a draft of a board type with groups of its data moved; raise ValueError if that is no board type."""
    to_mm = np.diag([board.mm_per_unit, board.mm_per_unit * (1 if board.y_axis == "up" else -1), 1.0])
    matrix = np.linalg.inv(to_mm) @ move.matrix @ to_mm
    digits = _DIGITS + round(math.log10(board.mm_per_unit))

    def at(point: tuple[float, float]) -> tuple[float, float]:
        x, y = apply(matrix, np.array(point))
        return round(float(x), digits), round(float(y), digits)

    def part(component: Component) -> Component:
        turned = (180 - component.rotation if move.mirrored else component.rotation) + move.degrees
        change: dict[str, Any] = {"center": at(component.center), "rotation": round(turned % 360, 4) % 360}
        if component.origin is not None:
            change["origin"] = at(component.origin)
        return component.model_copy(update=change)

    revision = f"{(board.revision or '')[:30]} corrected".strip()
    change: dict[str, Any] = {"state": "draft", "revision": revision}
    if "components" in groups:
        change["components"] = tuple(map(part, board.components))
        if (points := board.test_points) is not None:
            places = [at(place) for place in zip(points.x, points.y, strict=True)]
            x, y = zip(*places, strict=True) if places else ((), ())
            change["test_points"] = points.model_copy(update={"x": x, "y": y})
    if "fiducials" in groups:
        for key in ("fiducials", "other_marks", "fixture_marks"):
            marks = getattr(board, key)
            if marks is not None:
                places = [at((m.x, m.y)) for m in marks]
                change[key] = tuple(
                    m.model_copy(update={"x": x, "y": y}) for m, (x, y) in zip(marks, places, strict=True)
                )
        if board.identity is not None:
            # Codes are printed on the board, as its marks are. Their places lie along the axes, so a place that is
            # turned becomes the smallest such rectangle around itself.
            along = np.abs(matrix[:2, :2])
            moved = tuple(
                place.model_copy(update={"center": at(place.center), "width": width, "height": height})
                for place in board.identity.places
                for width, height in (np.round(along @ (place.width, place.height), digits).tolist(),)
            )
            change["identity"] = board.identity.model_copy(update={"places": moved})
    if "outline" in groups:
        if board.outline is not None:
            change["outline"] = tuple(map(at, _polygon(board.outline)))
        if board.cut_outs is not None:
            change["cut_outs"] = tuple(tuple(map(at, contour)) for contour in board.cut_outs)
    # Validated again: moved data may lie outside of an outline that stays.
    return BoardType.model_validate(board.model_copy(update=change).model_dump())


def _polygon(outline: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    """Return all corners of an outline: two opposite ones span no rectangle when they are turned."""
    if len(outline) > 2:
        return outline
    (x0, y0), (x1, y1) = outline
    return (x0, y0), (x1, y0), (x1, y1), (x0, y1)


def _pair(point: Floats) -> tuple[float, float]:
    return float(point[0]), float(point[1])
