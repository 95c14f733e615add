"""Render what one camera sees, before any blur: the surface of the board, its bodies, light and shadow.

Textures are sampled bilinearly on the supersampled grid. Cubic and Lanczos interpolation would displace the content.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.simulation.board.artwork import Artwork
from vaoi_station.simulation.board.bodies import Body
from vaoi_station.simulation.board.canvas import Bytes, Plane, to_bytes
from vaoi_station.simulation.board.layout import surface_z
from vaoi_station.simulation.imaging.lattice import OVERSAMPLING, Lattice
from vaoi_station.simulation.imaging.pinholes import Pinhole
from vaoi_station.simulation.imaging.surroundings import Surroundings
from vaoi_station.simulation.scenario import BoardSection, LightSection

DOME_MM = 0.08
"""Width of the slope at the edge of metal under a light with relief: standard deviation of its blur, mm."""
_SURFACE_STEPS = 4
_MIN_LEAN_PX = 0.02
_SUBPIXEL_BITS = 4
MAX_REMAP_PX = 2**15 - 2
"""Largest width or height of an image that OpenCV's `remap` can sample."""
_PLACEMENT_MARGIN_MM = 10.0
"""Margin of the search for nearby bodies. It exceeds any placement shift, and the parallax at the edge of a view."""


@dataclass(frozen=True)
class Placement:
    """Placement error of one part on one board: a shift and a small rotation relative to its CAD position."""

    shift_mm: tuple[float, float]
    turn_rad: float

    def to_board(self, nominal_mm: Floats, center_mm: tuple[float, float]) -> Floats:
        """Convert points (..., 2) of a part at its CAD position to their real board coordinates, mm."""
        return np.asarray((nominal_mm - center_mm) @ self._turn().T + center_mm + self.shift_mm)

    def to_nominal(self, board_mm: Floats, center_mm: tuple[float, float]) -> Floats:
        """Convert real board coordinates (..., 2) of points of a part to those at its CAD position, mm."""
        return np.asarray((board_mm - center_mm - self.shift_mm) @ self._turn() + center_mm)

    def _turn(self) -> Floats:
        c, s = math.cos(self.turn_rad), math.sin(self.turn_rad)
        return np.array([[c, -s], [s, c]])


@dataclass(frozen=True, eq=False)
class VisibleBody:
    """A body that one frame may show, with its position in tester coordinates and in the frame."""

    body: Body
    placement: Placement
    texture: Bytes
    outline_mm: Floats
    """Outline (k, 2) of the body in tester coordinates."""
    z_mm: float
    low_px: Floats
    """Outline at the foot of the body, raw pixels (k, 2). `top_px` is the outline at its top."""
    top_px: Floats

    def reach_mm(self, light: LightSection) -> Floats:
        """Return the vector (2,), mm, from the end of the body's shadow on the board to the point that casts it."""
        length = self.body.height_mm / math.tan(math.radians(light.elevation_deg))
        return length * np.array(light.direction)


class LitTextures:
    """The textures of an artwork as they appear under one light. The light changes the brightness of metal."""

    def __init__(self, artwork: Artwork, light: LightSection, turned_rad: float = 0.0) -> None:
        """Paint the textures of a board turned against tester coordinates, which matters for a light with relief."""
        self.surface = _scale_metal(artwork.surface, artwork.metal, light.metal)
        if light.relief:
            c, s = math.cos(turned_rad), math.sin(turned_rad)
            x, y = light.direction
            towards = (c * x + s * y, c * y - s * x)
            self.surface = _shade_domes(self.surface, artwork, towards, light.relief)
        self.tops = tuple(_scale_metal(b.top, b.metal, light.metal) for b in artwork.bodies)


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything that a camera can see of a board: the shape of its surface, its artwork, and the belt around it."""

    section: BoardSection
    artwork: Artwork
    belt_grey: float
    surroundings: Surroundings | None = None
    """What lies beside the board, if that is more than a belt of even grey."""

    def surface_z(self, board_mm: Floats) -> Floats:
        """Return the height (k,), mm, of the board's surface above the calibrated plane at board coordinates (k, 2)."""
        return surface_z(self.section, board_mm)

    def view(
        self,
        camera: Pinhole,
        pose: Floats,
        *,
        paint: LitTextures,
        light: LightSection,
        placements: Mapping[str, Placement | None],
        belt_pose: Floats | None = None,
        labels: Sequence[Body] = (),
    ) -> Plane:
        """Render the grey values (2h, 2w) that one camera sees, with two samples per pixel and axis.

        `pose` is tester_from_board (3, 3); `belt_pose`, from the belt's texture to tester coordinates, is needed with
        surroundings. The placement of an absent part is None. Labels are bodies without height.
        """
        image = self._surface(camera, pose, paint.surface, belt_pose)
        back: Floats = np.asarray(np.linalg.inv(pose), np.float64)
        for label in labels:
            _draw_top(image, camera, back, self._placed(label, camera, pose, label.top, Placement((0.0, 0.0), 0.0)))
        visible = self._visible(camera, pose, paint, placements)
        if light.shadow:
            for body in visible:
                end = camera.project(body.outline_mm - body.reach_mm(light), body.z_mm)
                _cast_shadow(image, end, body.low_px, light.shadow)
        # Bodies further from the foot of the camera come first: parallax displaces every body away from the foot.
        for body in visible:
            _draw_sides(image, body, light)
            _draw_top(image, camera, back, body)
        return image.astype(np.float32)

    def _visible(
        self, camera: Pinhole, pose: Floats, paint: LitTextures, placements: Mapping[str, Placement | None]
    ) -> list[VisibleBody]:
        """Return the bodies that a frame can show, sorted by their distance from the camera's foot, furthest first."""
        found = []
        size = np.array([camera.width_px, camera.height_px])
        for k in self.nearby_bodies(camera, pose):
            body, texture = self.artwork.bodies[k], paint.tops[k]
            placement = placements[body.ref]
            if placement is None:
                continue
            placed = self._placed(body, camera, pose, texture, placement)
            both, margin = np.vstack([placed.low_px, placed.top_px]), 2 * body.height_mm * body.px_per_mm + 2
            if (both.max(0) > -margin).all() and (both.min(0) < size + margin).all():
                found.append(placed)
        return sorted(found, key=lambda b: -float(np.hypot(*(b.outline_mm.mean(0) - camera.foot_mm))))

    def _placed(self, body: Body, camera: Pinhole, pose: Floats, texture: Bytes, placement: Placement) -> VisibleBody:
        outline = apply(pose, placement.to_board(body.outline_mm, body.center_mm))
        z = float(self.surface_z(np.array([body.center_mm]))[0])
        low, top = camera.project(outline, z), camera.project(outline, z + body.height_mm)
        return VisibleBody(body, placement, texture, outline, z, low, top)

    @cached_property
    def _body_extents(self) -> tuple[Floats, Floats]:
        """Centres (k, 2) of all bodies, and radii (k,) around them that contain body and shadow, mm."""
        bodies = self.artwork.bodies
        middles = np.array([b.center_mm for b in bodies], dtype=np.float64).reshape(-1, 2)
        reach = [np.abs(b.outline_mm - b.center_mm).max() * math.sqrt(2) + 4 * b.height_mm for b in bodies]
        return middles, np.array(reach) + _PLACEMENT_MARGIN_MM

    def nearby_bodies(self, camera: Pinhole, pose: Floats) -> list[int]:
        """Return the indices of the bodies that may be visible. A coarse test that saves projecting all bodies."""
        middles, reach = self._body_extents
        w, h = camera.width_px - 1.0, camera.height_px - 1.0
        corners = camera.ground(np.array([[0, 0], [w, 0], [w, h], [0, h]]), 0.0)
        away = np.abs(apply(pose, middles) - corners.mean(0)) - np.ptp(corners, axis=0) / 2
        return np.flatnonzero((away < reach[:, None]).all(1)).tolist()

    def _surface(self, camera: Pinhole, pose: Floats, texture: Bytes, belt_pose: Floats | None) -> Bytes:
        """Render the surface of the board and the belt on the supersampled grid, (2h, 2w)."""
        size = np.array([camera.width_px, camera.height_px])
        lattice = Lattice.over(np.zeros(2), size - 1.0, camera.width_px, camera.height_px)
        assert lattice is not None
        back, z = np.linalg.inv(pose), np.full(len(lattice.nodes_px), self.section.lift_mm)
        place = apply(back, camera.ground(lattice.nodes_px, z))
        # The height depends on the position and the position on the height. Four fixed-point steps reach 1e-6 mm.
        if self.section.bow_mm or any(self.section.tilt_mm):
            for _ in range(_SURFACE_STEPS):
                place = apply(back, camera.ground(lattice.nodes_px, self.surface_z(place)))
        t = self.artwork.to_px(place)
        shape = (camera.height_px * OVERSAMPLING, camera.width_px * OVERSAMPLING)
        if max(texture.shape) > MAX_REMAP_PX:
            texture, t = _crop_texture(texture, t)
        x, y = lattice.spread(t[:, 0], shape), lattice.spread(t[:, 1], shape)
        image = np.asarray(cv2.remap(texture, x, y, cv2.INTER_LINEAR, borderValue=round(self.belt_grey)))
        if self.surroundings is None:
            return image
        assert belt_pose is not None
        return self.surroundings.draw(image, camera, lattice, place, pose, belt_pose)


def _crop_texture(texture: Bytes, px: Floats) -> tuple[Bytes, Floats]:
    """Crop a texture too large for OpenCV's `remap` around pixels (k, 2), and return these in the crop, too."""
    size = np.array(texture.shape[::-1])
    low = np.clip(np.floor(px.min(0)).astype(int) - 2, 0, size - 1)
    high = np.clip(np.ceil(px.max(0)).astype(int) + 3, low + 1, size)
    return texture[low[1] : high[1], low[0] : high[0]], px - low


def _scale_metal(grey: Bytes, metal: Bytes, gain: float) -> Bytes:
    """Multiply the grey values of a texture by `gain` where it is metal, in proportion to the share of metal."""
    if gain == 1:
        return grey
    return to_bytes(grey * (1 + (gain - 1) * (metal.astype(np.float32) / 255)))


def _shade_domes(grey: Bytes, artwork: Artwork, towards: tuple[float, float], relief: float) -> Bytes:
    """Shade metal as flat domes of solder, by `relief` on the steepest slope towards the lamp or away from it."""
    metal = artwork.metal.astype(np.float32) / 255
    dome = cv2.GaussianBlur(metal, (0, 0), DOME_MM * artwork.px_per_mm)
    # At a straight edge, the blurred step has its steepest slope, 1 / (σ · √(2π)).
    steepest = 1 / (DOME_MM * artwork.px_per_mm * math.sqrt(2 * math.pi))
    slope = cv2.Sobel(dome, cv2.CV_32F, 1, 0, scale=1 / 8) * towards[0]
    slope += cv2.Sobel(dome, cv2.CV_32F, 0, 1, scale=1 / 8) * towards[1]
    facing = np.clip(-slope / np.float32(steepest), -1, 1)
    return to_bytes(grey * (1 + np.float32(relief) * facing * metal))


def _to_samples(raw_px: Floats) -> Floats:
    """Convert raw pixels (..., 2) to coordinates (..., 2) of the supersampled image."""
    return (raw_px + 0.5) * OVERSAMPLING - 0.5


def _fill_polygon(image: Bytes, raw_px: Floats, grey: float) -> None:
    """Fill a convex polygon of raw pixels (k, 2), with an accuracy of 1/16 sample."""
    points = np.round(_to_samples(raw_px) * (1 << _SUBPIXEL_BITS)).astype(np.int32)
    cv2.fillConvexPoly(image, points, round(grey), cv2.LINE_AA, _SUBPIXEL_BITS)


def _draw_sides(image: Bytes, visible: VisibleBody, light: LightSection) -> None:
    low, top = visible.low_px, visible.top_px
    # Seen from directly above, the top hides all walls.
    if np.abs(top - low).max() < _MIN_LEAN_PX:
        return
    middle = low.mean(0)
    # Walls on the far side are drawn too. The top is drawn afterwards and hides them.
    for k in range(len(low)):
        n = (k + 1) % len(low)
        outward = (low[k] + low[n]) / 2 - middle
        facing = float(outward @ light.direction) / (float(np.hypot(*outward)) + 1e-9)
        grey = min(visible.body.side_grey * (1 + 2 * light.shading * facing), 255.0)
        _fill_polygon(image, np.array([low[k], low[n], top[n], top[k]]), grey)


def _draw_top(image: Bytes, camera: Pinhole, board_from_tester: Floats, visible: VisibleBody) -> None:
    """Draw the top of a body at its height. Each sample is blended by the share that the top covers."""
    body, top = visible.body, visible.top_px
    lattice = Lattice.over(top.min(0) - 1, top.max(0) + 1, camera.width_px, camera.height_px)
    if lattice is None:
        return
    seen = image[lattice.window]
    place = apply(board_from_tester, camera.ground(lattice.nodes_px, visible.z_mm + body.height_mm))
    t = body.to_px(visible.placement.to_nominal(place, body.center_mm))
    x, y = (lattice.spread(t[:, k], (seen.shape[0], seen.shape[1])) for k in (0, 1))
    cover = cv2.remap(body.cover, x, y, cv2.INTER_LINEAR, borderValue=0).astype(np.float32) / 255
    grey = cv2.remap(visible.texture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    seen[:] = np.rint(seen + (grey.astype(np.float32) - seen) * cover).astype(np.uint8)


def _cast_shadow(image: Bytes, end: Floats, low: Floats, depth: float) -> None:
    """Darken the shadow of a body: the convex hull of the shadow's end and of the body's foot, raw pixels (k, 2)."""
    hull = cv2.convexHull(np.vstack([low, end]).astype(np.float32))[:, 0]
    points = _to_samples(hull)
    x0, y0 = np.maximum(np.floor(points.min(0)).astype(int) - 1, 0)
    x1, y1 = np.ceil(points.max(0)).astype(int) + 2
    part = image[y0 : max(y1, 0), x0 : max(x1, 0)]
    if not part.size:
        return
    mask = np.zeros(part.shape, np.uint8)
    shifted = np.round((points - (x0, y0)) * (1 << _SUBPIXEL_BITS)).astype(np.int32)
    cv2.fillConvexPoly(mask, shifted, 255, cv2.LINE_AA, _SUBPIXEL_BITS)
    part[:] = np.rint(part * (1 - mask.astype(np.float32) * np.float32(depth / 255))).astype(np.uint8)
