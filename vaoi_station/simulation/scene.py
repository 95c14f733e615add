"""What one camera's rays meet: the board's surface, the bodies on it, light and shadow; before any blur.

Sampled bilinearly on the supersampled grid: unlike cubic and Lanczos kernels that shifts nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.simulation.artwork import Artwork, to_bytes
from vaoi_station.simulation.bodies import Body
from vaoi_station.simulation.canvas import Bytes, Plane
from vaoi_station.simulation.lattice import OVERSAMPLING, Lattice
from vaoi_station.simulation.pinholes import Pinhole
from vaoi_station.simulation.scenario import BoardSection, LightSection

_SURFACE_STEPS = 4
_LEAST_LEAN_PX = 0.02
_SIXTEENTHS = 4


@dataclass(frozen=True)
class Placement:
    """How one part of one board was set: off its CAD place by a shift and a small turn."""

    shift_mm: tuple[float, float]
    turn_rad: float

    def to_board(self, nominal_mm: Floats, middle_mm: tuple[float, float]) -> Floats:
        """Where points of the part (..., 2) really are."""
        return np.asarray((nominal_mm - middle_mm) @ self._turn().T + middle_mm + self.shift_mm)

    def to_nominal(self, board_mm: Floats, middle_mm: tuple[float, float]) -> Floats:
        """The way back."""
        return np.asarray((board_mm - middle_mm - self.shift_mm) @ self._turn() + middle_mm)

    def _turn(self) -> Floats:
        c, s = math.cos(self.turn_rad), math.sin(self.turn_rad)
        return np.array([[c, -s], [s, c]])


class Paint:
    """Textures under one light: metal is brighter or darker than it is under the plain one."""

    def __init__(self, artwork: Artwork, light: LightSection) -> None:
        self.surface = _lit(artwork.surface, artwork.metal, light.metal)
        self.tops = tuple(_lit(b.top, b.metal, light.metal) for b in artwork.bodies)


@dataclass(frozen=True, eq=False)
class Scene:
    """A board type's looks and surface, with what lies around it."""

    section: BoardSection
    artwork: Artwork
    belt_grey: float

    def surface_z(self, board_mm: Floats) -> Floats:
        """Height (k,) of the board's surface above the calibrated plane at board places (k, 2)."""
        s = self.section
        u, v = (board_mm / (s.width_mm, s.length_mm) * 2 - 1).T
        bow = s.bow_mm * (1 - (0.4 * u * u + 0.6 * v * v))
        return np.asarray(s.lift_mm + s.tilt_mm[0] * u + s.tilt_mm[1] * v + bow)

    def view(
        self,
        camera: Pinhole,
        pose: Floats,
        paint: Paint,
        light: LightSection,
        placements: Mapping[str, Placement | None],
    ) -> Plane:
        """Grey values (2h, 2w) that the rays of one camera meet, the board being at `pose`.

        Bodies further from the foot of the camera are drawn first: all lean outwards, none inwards.
        """
        image = self._surface(camera, pose, paint.surface)
        standing = [(n, b, p) for n, b in enumerate(self.artwork.bodies) if (p := placements[b.ref]) is not None]
        middles = apply(pose, np.array([b.middle_mm for _, b, _ in standing]).reshape(-1, 2))
        order = np.argsort(-np.hypot(*(middles - camera.foot_mm).T), kind="stable")
        visible = [drawn for k in order if (drawn := self._outlines(camera, pose, *standing[k][1:]))]
        if light.shadow:
            for body, _, placement, low, _ in visible:
                _cast_shadow(image, self._shadow(camera, pose, body, placement, light), low, light.shadow)
        numbers = {b.ref: n for n, b, _ in standing}
        for body, z, placement, low, top in visible:
            _draw_sides(image, low, top, body, light)
            self._draw_top(image, camera, pose, body, placement, z, top, paint.tops[numbers[body.ref]])
        return image.astype(np.float32)

    def _surface(self, camera: Pinhole, pose: Floats, texture: Bytes) -> Bytes:
        size = np.array([camera.width_px, camera.height_px])
        lattice = Lattice.over(np.zeros(2), size - 1.0, camera.width_px, camera.height_px)
        assert lattice is not None
        back, z = np.linalg.inv(pose), np.full(len(lattice.nodes_px), self.section.lift_mm)
        place = apply(back, camera.ground(lattice.nodes_px, z))
        if self.section.bow_mm or any(self.section.tilt_mm):
            for _ in range(_SURFACE_STEPS):
                place = apply(back, camera.ground(lattice.nodes_px, self.surface_z(place)))
        t = self.artwork.to_px(place)
        shape = (camera.height_px * OVERSAMPLING, camera.width_px * OVERSAMPLING)
        x, y = lattice.spread(t[:, 0], shape), lattice.spread(t[:, 1], shape)
        return np.asarray(cv2.remap(texture, x, y, cv2.INTER_LINEAR, borderValue=round(self.belt_grey)))

    def _outlines(
        self, camera: Pinhole, pose: Floats, body: Body, placement: Placement
    ) -> tuple[Body, float, Placement, Floats, Floats] | None:
        """A body's outline at its foot and at its top in raw pixels, if the frame can show it."""
        outline = apply(pose, placement.to_board(body.outline_mm, body.middle_mm))
        z = float(self.surface_z(np.array([body.middle_mm]))[0])
        low, top = camera.project(outline, z), camera.project(outline, z + body.height_mm)
        both, margin = np.vstack([low, top]), 4.0 * body.px_per_mm
        if (both.max(0) < -margin).any() or (both.min(0) > [camera.width_px + margin, camera.height_px + margin]).any():
            return None
        return body, z, placement, low, top

    def _shadow(self, camera: Pinhole, pose: Floats, body: Body, placement: Placement, light: LightSection) -> Floats:
        """Raw pixels of the end of a body's shadow on the board."""
        outline = apply(pose, placement.to_board(body.outline_mm, body.middle_mm))
        z = float(self.surface_z(np.array([body.middle_mm]))[0])
        reach = body.height_mm / math.tan(math.radians(light.elevation_deg))
        return camera.project(outline - reach * np.array(light.direction), z)

    def _draw_top(
        self,
        image: Bytes,
        camera: Pinhole,
        pose: Floats,
        body: Body,
        placement: Placement,
        z: float,
        top: Floats,
        texture: Bytes,
    ) -> None:
        lattice = Lattice.over(top.min(0) - 1, top.max(0) + 1, camera.width_px, camera.height_px)
        if lattice is None:
            return
        seen = image[lattice.window]
        place = apply(np.linalg.inv(pose), camera.ground(lattice.nodes_px, z + body.height_mm))
        t = body.to_px(placement.to_nominal(place, body.middle_mm))
        x, y = (lattice.spread(t[:, k], (seen.shape[0], seen.shape[1])) for k in (0, 1))
        cover = cv2.remap(body.cover, x, y, cv2.INTER_LINEAR, borderValue=0).astype(np.float32) / 255
        grey = cv2.remap(texture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32)
        seen[:] = np.rint(seen + (grey - seen) * cover).astype(np.uint8)


def _lit(grey: Bytes, metal: Bytes, gain: float) -> Bytes:
    if gain == 1:
        return grey
    return to_bytes(grey * (1 + (gain - 1) * (metal.astype(np.float32) / 255)))


def _samples(raw_px: Floats) -> Floats:
    """Sample coordinates of raw pixels: the supersampled grid shares the frame's outer edges."""
    return (raw_px + 0.5) * OVERSAMPLING - 0.5


def _fill(image: Bytes, raw_px: Floats, grey: float) -> None:
    points = np.round(_samples(raw_px) * (1 << _SIXTEENTHS)).astype(np.int32)
    cv2.fillConvexPoly(image, points, round(grey), cv2.LINE_AA, _SIXTEENTHS)


def _draw_sides(image: Bytes, low: Floats, top: Floats, body: Body, light: LightSection) -> None:
    """The walls between foot and top; the top, drawn later, hides those that face away."""
    if np.abs(top - low).max() < _LEAST_LEAN_PX:
        return
    middle = low.mean(0)
    for k in range(len(low)):
        n = (k + 1) % len(low)
        outward = (low[k] + low[n]) / 2 - middle
        facing = float(outward @ light.direction) / (float(np.hypot(*outward)) + 1e-9)
        grey = min(body.side_grey * (1 + 2 * light.shading * facing), 255.0)
        _fill(image, np.array([low[k], low[n], top[n], top[k]]), grey)


def _cast_shadow(image: Bytes, end: Floats, low: Floats, depth: float) -> None:
    hull = cv2.convexHull(np.vstack([low, end]).astype(np.float32))[:, 0]
    points = _samples(hull)
    x0, y0 = np.maximum(np.floor(points.min(0)).astype(int) - 1, 0)
    x1, y1 = np.ceil(points.max(0)).astype(int) + 2
    part = image[y0 : max(y1, 0), x0 : max(x1, 0)]
    if not part.size:
        return
    mask = np.zeros(part.shape, np.uint8)
    shifted = np.round((points - (x0, y0)) * (1 << _SIXTEENTHS)).astype(np.int32)
    cv2.fillConvexPoly(mask, shifted, 255, cv2.LINE_AA, _SIXTEENTHS)
    part[:] = np.rint(part * (1 - mask.astype(np.float32) * np.float32(depth / 255))).astype(np.uint8)
