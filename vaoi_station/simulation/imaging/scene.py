"""What one camera's rays meet: the board's surface, the bodies on it, light and shadow; before any blur.

Sampled bilinearly on the supersampled grid: unlike cubic and Lanczos kernels that shifts nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.simulation.board.artwork import Artwork
from vaoi_station.simulation.board.bodies import Body
from vaoi_station.simulation.board.canvas import Bytes, Plane, to_bytes
from vaoi_station.simulation.imaging.lattice import OVERSAMPLING, Lattice
from vaoi_station.simulation.imaging.pinholes import Pinhole
from vaoi_station.simulation.scenario import BoardSection, LightSection

_SURFACE_STEPS = 4
_LEAST_LEAN_PX = 0.02
_SIXTEENTHS = 4
_MOST_PX = 2**15 - 2
"""OpenCV samples images of no more pixels along an axis."""
_ROOM_MM = 10.0
"""More than a placement's shift and the lean of what stands at the edge of a view."""


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


@dataclass(frozen=True, eq=False)
class Standing:
    """One body of one board as one frame shows it."""

    body: Body
    placement: Placement
    texture: Bytes
    outline_mm: Floats
    """In tester coordinates."""
    z_mm: float
    low_px: Floats
    """The outline's raw pixels at its foot, and below at its top."""
    top_px: Floats

    def reach_mm(self, light: LightSection) -> Floats:
        """From the end of its shadow on the board to the body, (2,)."""
        length = self.body.height_mm / math.tan(math.radians(light.elevation_deg))
        return length * np.array(light.direction)


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
        *,
        paint: Paint,
        light: LightSection,
        placements: Mapping[str, Placement | None],
    ) -> Plane:
        """Grey values (2h, 2w) that the rays of one camera meet, the board being at `pose`.

        Bodies further from the foot of the camera are drawn first: all lean outwards, none inwards.
        """
        image = self._surface(camera, pose, paint.surface)
        visible = self._visible(camera, pose, paint, placements)
        if light.shadow:
            for body in visible:
                end = camera.project(body.outline_mm - body.reach_mm(light), body.z_mm)
                _cast_shadow(image, end, body.low_px, light.shadow)
        back: Floats = np.asarray(np.linalg.inv(pose), np.float64)
        for body in visible:
            _draw_sides(image, body, light)
            _draw_top(image, camera, back, body)
        return image.astype(np.float32)

    def _visible(
        self, camera: Pinhole, pose: Floats, paint: Paint, placements: Mapping[str, Placement | None]
    ) -> list[Standing]:
        """The bodies a frame can show, those furthest from the camera's foot first."""
        found = []
        size = np.array([camera.width_px, camera.height_px])
        for k in self._about(camera, pose):
            body, texture = self.artwork.bodies[k], paint.tops[k]
            placement = placements[body.ref]
            if placement is None:
                continue
            outline = apply(pose, placement.to_board(body.outline_mm, body.middle_mm))
            z = float(self.surface_z(np.array([body.middle_mm]))[0])
            low, top = camera.project(outline, z), camera.project(outline, z + body.height_mm)
            both, margin = np.vstack([low, top]), 2 * body.height_mm * body.px_per_mm + 2
            if (both.max(0) > -margin).all() and (both.min(0) < size + margin).all():
                found.append(Standing(body, placement, texture, outline, z, low, top))
        return sorted(found, key=lambda b: -float(np.hypot(*(b.outline_mm.mean(0) - camera.foot_mm))))

    @cached_property
    def _whereabouts(self) -> tuple[Floats, Floats]:
        """Middles (k, 2) of all bodies, and how far (k,) from there anything of them or their shadows may be, in mm."""
        bodies = self.artwork.bodies
        middles = np.array([b.middle_mm for b in bodies], dtype=np.float64).reshape(-1, 2)
        reach = [np.abs(b.outline_mm - b.middle_mm).max() * math.sqrt(2) + 4 * b.height_mm for b in bodies]
        return middles, np.array(reach) + _ROOM_MM

    def _about(self, camera: Pinhole, pose: Floats) -> list[int]:
        """The bodies that are near enough to the view to be looked at one by one."""
        middles, reach = self._whereabouts
        w, h = camera.width_px - 1.0, camera.height_px - 1.0
        corners = camera.ground(np.array([[0, 0], [w, 0], [w, h], [0, h]]), 0.0)
        away = np.abs(apply(pose, middles) - corners.mean(0)) - np.ptp(corners, axis=0) / 2
        return np.flatnonzero((away < reach[:, None]).all(1)).tolist()

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
        if max(texture.shape) > _MOST_PX:
            texture, t = _in_reach(texture, t)
        x, y = lattice.spread(t[:, 0], shape), lattice.spread(t[:, 1], shape)
        return np.asarray(cv2.remap(texture, x, y, cv2.INTER_LINEAR, borderValue=round(self.belt_grey)))


def _in_reach(texture: Bytes, px: Floats) -> tuple[Bytes, Floats]:
    """The part of a texture about pixels (k, 2), which OpenCV could not sample as a whole, and the pixels on it."""
    size = np.array(texture.shape[::-1])
    low = np.clip(np.floor(px.min(0)).astype(int) - 2, 0, size - 1)
    high = np.clip(np.ceil(px.max(0)).astype(int) + 3, low + 1, size)
    return texture[low[1] : high[1], low[0] : high[0]], px - low


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


def _draw_sides(image: Bytes, standing: Standing, light: LightSection) -> None:
    """The walls between foot and top; the top, drawn later, hides those that face away."""
    low, top = standing.low_px, standing.top_px
    if np.abs(top - low).max() < _LEAST_LEAN_PX:
        return
    middle = low.mean(0)
    for k in range(len(low)):
        n = (k + 1) % len(low)
        outward = (low[k] + low[n]) / 2 - middle
        facing = float(outward @ light.direction) / (float(np.hypot(*outward)) + 1e-9)
        grey = min(standing.body.side_grey * (1 + 2 * light.shading * facing), 255.0)
        _fill(image, np.array([low[k], low[n], top[n], top[k]]), grey)


def _draw_top(image: Bytes, camera: Pinhole, board_from_tester: Floats, standing: Standing) -> None:
    """The top at its height, blended by the share of each sample it covers."""
    body, top = standing.body, standing.top_px
    lattice = Lattice.over(top.min(0) - 1, top.max(0) + 1, camera.width_px, camera.height_px)
    if lattice is None:
        return
    seen = image[lattice.window]
    place = apply(board_from_tester, camera.ground(lattice.nodes_px, standing.z_mm + body.height_mm))
    t = body.to_px(standing.placement.to_nominal(place, body.middle_mm))
    x, y = (lattice.spread(t[:, k], (seen.shape[0], seen.shape[1])) for k in (0, 1))
    cover = cv2.remap(body.cover, x, y, cv2.INTER_LINEAR, borderValue=0).astype(np.float32) / 255
    grey = cv2.remap(standing.texture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    seen[:] = np.rint(seen + (grey.astype(np.float32) - seen) * cover).astype(np.uint8)


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
