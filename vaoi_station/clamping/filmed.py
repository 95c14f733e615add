"""What a run knows of its board for the hand-over: places of fiducials and points, heights, and their errors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vaoi_station.errors import StateError
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import BoardType, Component, Status, Stitch

_UNKNOWN_PX, _UNSEEN_MM = 0.3, 0.03
"""Standard deviation of places in results that state none, and of a fiducial that was not found."""


@dataclass(frozen=True, eq=False)
class FilmedBoard:
    """A board type and the result of a run. StateError: the run has no CAD mapping."""

    board_type: BoardType
    result: Stitch
    """With the heights of bodies in its `quality`, if they are known."""
    px_per_mm: float
    status: Status = Status.OK
    """The verdict of the run."""
    reasons: tuple[str, ...] = ()
    """Why it is not `ok`."""

    def __post_init__(self) -> None:
        if self.result.cad_matrix is None:
            raise StateError(
                "The run has no CAD mapping: its fiducials were not found.",
                action="See the reasons of the run; film the board again.",
                code="no-cad-mapping",
            )

    def matrix(self, board: object) -> Floats:
        """Return the matrix (3, 3) from CAD to filmed coordinates of a board of a panel; None: of the panel."""
        own = (self.result.board_matrices or {}).get(str(board)) if board is not None else None
        return np.asarray(self.result.cad_matrix if own is None else own, np.float64)

    @cached_property
    def numbers(self) -> Mapping[str, int]:
        """The numbers of the fiducials by name."""
        return {f.name: n for n, f in enumerate(self.board_type.fiducials)}

    @cached_property
    def parts(self) -> Mapping[str, Component]:
        """The components by address."""
        return {c.address: c for c in self.board_type.components}

    @cached_property
    def test_points(self) -> Mapping[str, tuple[float, float, str]]:
        """The CAD coordinates and nets of the test points by name."""
        table = self.board_type.test_points
        if table is None:
            return {}
        nets = table.net or ("",) * len(table.name)
        return dict(zip(table.name, zip(table.x, table.y, nets, strict=True), strict=True))

    @cached_property
    def positions(self) -> Collection[str]:
        """The positions of the boards of a panel."""
        return {str(c.panel) for c in self.board_type.components if c.panel is not None}

    def part_of(self, point: str) -> Component | None:
        """Return the component of a test point: of `U1-3` it is U1; netlists have six letters of a designator."""
        while "-" in point:
            point = point.rpartition("-")[0]
            if (part := self.parts.get(point) or self._by_six_letters.get(point)) is not None:
                return part
        return None

    @cached_property
    def _by_six_letters(self) -> Mapping[str, Component]:
        def short(address: str) -> str:
            panel, slash, ref = address.rpartition("/")
            return f"{panel}{slash}{ref[:6]}"

        counts = Counter(map(short, self.parts))
        return {short(a): part for a, part in self.parts.items() if short(a) != a and counts[short(a)] == 1}

    @cached_property
    def cad(self) -> Floats:
        """(f, 2) CAD coordinates of the fiducials."""
        return np.array([(f.x, f.y) for f in self.board_type.fiducials], np.float64).reshape(-1, 2)

    @cached_property
    def _by_cad(self) -> Floats:
        """(f, 2) filmed places of the fiducials if they are at their CAD positions, on their boards."""
        boards = [self.matrix(f.panel) for f in self.board_type.fiducials]
        return np.array([apply(m, at) for m, at in zip(boards, self.cad, strict=True)]).reshape(-1, 2)

    @cached_property
    def _off_px(self) -> Floats:
        """(f, 2) mean residuals against C; NaN for fiducials that were not found."""
        listed = {e["name"]: e["residual_px"] for e in self.result.quality.get("fiducials", ())}
        none = (np.nan, np.nan)
        return np.array([listed.get(f.name) or none for f in self.board_type.fiducials], np.float64).reshape(-1, 2)

    @cached_property
    def places(self) -> Floats:
        """(f, 2) places of the fiducials as filmed, mm."""
        seen = apply(self.matrix(None), self.cad) + self._off_px / self.px_per_mm
        return np.where(np.isfinite(self._off_px), seen, self._by_cad)

    @cached_property
    def sigma_mm(self) -> Floats:
        """(f,) their standard deviations, per axis."""
        px = self.result.quality.get("cad_sigma_px")
        own = (_UNKNOWN_PX if px is None else float(px)) / self.px_per_mm
        return np.where(np.isfinite(self._off_px[:, 0]), own, float(np.hypot(own, _UNSEEN_MM)))

    @cached_property
    def place_sigma_mm(self) -> float:
        """Standard deviation of a point against the fiducials: of the film, and of the artwork as fiducials show it."""
        seen = np.isfinite(self._off_px[:, 0])
        off = (self.places - self._by_cad)[seen]
        # C takes four numbers from the residuals.
        artwork = float(np.sqrt((off**2).sum() / max(2 * len(off) - 4, 1)))
        return float(np.hypot(self.sigma_mm.min(initial=_UNKNOWN_PX / self.px_per_mm), artwork))

    @cached_property
    def half(self) -> tuple[Floats, Floats]:
        """Middle and half extent of the board, at least 1 mm, CAD units."""
        low, high = self.board_type.extent()
        return (low + high) / 2, np.maximum((high - low) / 2, 1.0 / self.board_type.mm_per_unit)

    def corners(self, part: Component) -> list[tuple[float, float]]:
        """Return the corners of a component's footprint, CAD coordinates."""
        return [(x, y) for x, y in self.board_type.footprint(part).tolist()]

    def height_mm(self, cad: Floats) -> Floats:
        """Return the height (k,) of the surface as filmed; 0 if it was not estimated."""
        surface = self.result.surface
        return np.zeros(len(cad)) if surface is None else surface.height_mm(cad)

    @property
    def surface_sigma_mm(self) -> float:
        """Standard deviation of `height_mm`; 0.5 mm if the surface was not estimated."""
        sigma = self.result.quality.get("surface_sigma_mm")
        return 0.5 if sigma is None or self.result.surface is None else float(sigma)
