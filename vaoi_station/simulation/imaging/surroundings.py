"""What a camera sees beside the board: the texture of the belt, and the carrier in which the board rides.

The texture of the board has a narrow margin in the belt's mean grey. Belt texture and carrier are added as differences
from this grey. In each sample they count with the share that the board does not cover.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.simulation.board.artwork import paint_fiducial
from vaoi_station.simulation.board.canvas import Bytes, Canvas, Plane
from vaoi_station.simulation.imaging.lattice import Lattice
from vaoi_station.simulation.imaging.pinholes import Pinhole
from vaoi_station.simulation.scenario import BoardSection, CarrierSection, TextureSection

_TILE_PX = 2048
"""Side of the tile of belt texture, which repeats. It is wider than the view of most cameras."""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """The belt's texture and the carrier of a scenario."""

    texture: TextureSection
    carrier: CarrierSection
    board: BoardSection
    belt_grey: float
    px_per_mm: float
    """Resolution of the textures, px per mm."""

    def draw(
        self, image: Bytes, camera: Pinhole, lattice: Lattice, seen_mm: Floats, pose: Floats, belt_pose: Floats
    ) -> Bytes:
        """Return the surface (2h, 2w) of a board, rendered on a belt of even grey, with belt texture and carrier.

        `seen_mm` are the board coordinates (k, 2) of the lattice's nodes on the board's surface. `pose` and `belt_pose`
        (3, 3) lead from the board and from the belt's texture to tester coordinates.
        """
        shape = (image.shape[0], image.shape[1])
        size = (self.board.width_mm, self.board.length_mm)
        beside = np.zeros(shape, np.float32)
        if self.texture.sigma_grey:
            at = self._place(camera, lattice, belt_pose, -self.texture.below_mm) * self.px_per_mm
            # OpenCV's `remap` is limited to 15 bits.
            at -= np.floor(at.min(0) / _TILE_PX) * _TILE_PX
            x, y = (lattice.spread(at[:, k], shape) for k in (0, 1))
            beside += cv2.remap(self._tile, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        if self.carrier.rim_mm:
            rim, canvas = self.carrier.rim_mm, self._carrier
            on_carrier = self._place(camera, lattice, pose, self.board.lift_mm - self.carrier.below_mm)
            at = canvas.to_px(on_carrier)
            x, y = (lattice.spread(at[:, k], shape) for k in (0, 1))
            grey = cv2.remap(canvas.grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) - self.belt_grey
            held = (-rim, size[0] + rim, -rim, size[1] + rim)
            beside += (grey - beside) * self._cover(lattice, on_carrier, held, shape)
        free = 1 - self._cover(lattice, seen_mm, (0.0, size[0], 0.0, size[1]), shape)
        return np.asarray(np.clip(np.rint(image + beside * free), 0, 255), np.uint8)

    @cached_property
    def _tile(self) -> Plane:
        """The texture of the belt as differences from its mean grey; it repeats without visible borders."""
        noise = np.random.default_rng([self.texture.seed, 7050]).standard_normal((_TILE_PX, _TILE_PX))
        wave = np.fft.fftfreq(_TILE_PX) * 2 * np.pi * max(self.texture.grain_mm * self.px_per_mm, 0.6)
        soft = np.exp(-(wave**2) / 2)
        grain = np.fft.ifft2(np.fft.fft2(noise) * soft[:, None] * soft).real
        return np.asarray(grain * (self.texture.sigma_grey / grain.std()), np.float32)

    @cached_property
    def _carrier(self) -> Canvas:
        """The carrier as seen without the board, on the plane of the board's coordinates."""
        c, rim = self.carrier, self.carrier.rim_mm
        size = (self.board.width_mm + 2 * rim, self.board.length_mm + 2 * rim)
        canvas = Canvas.blank((-rim, -rim), size, self.px_per_mm, c.grey)
        g = np.random.default_rng([c.seed, 7051])
        grain = cv2.GaussianBlur(g.standard_normal(canvas.grey.shape, dtype=np.float32), (0, 0), 0.1 * self.px_per_mm)
        canvas.grey[:] += c.sigma_grey / grain.std() * grain
        for mark in c.marks:
            paint_fiducial(canvas, mark)
        return canvas

    @staticmethod
    def _place(camera: Pinhole, lattice: Lattice, pose: Floats, z_mm: float) -> Floats:
        """Return the positions (k, 2), mm, that the nodes see on a plane at height `z_mm` which moves with `pose`."""
        return np.asarray(apply(np.linalg.inv(pose), camera.ground(lattice.nodes_px, z_mm)))

    def _cover(
        self, lattice: Lattice, place_mm: Floats, box: tuple[float, float, float, float], shape: tuple[int, int]
    ) -> Plane:
        """Return the share (2h, 2w) of each sample that a rectangle (x0, x1, y0, y1) covers, mm."""
        x, y = (lattice.spread(place_mm[:, k], shape) for k in (0, 1))
        x0, x1, y0, y1 = box
        depth = np.minimum(np.minimum(x - x0, x1 - x), np.minimum(y - y0, y1 - y))
        return np.asarray(np.clip(depth * self.px_per_mm + 0.5, 0, 1), np.float32)
