"""The points that a tester asks for, and the bodies that it must not touch, in its coordinates."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import TypeAdapter

from vaoi_station.clamping import documents as doc
from vaoi_station.clamping.bending import Bending
from vaoi_station.clamping.filmed import FilmedBoard
from vaoi_station.clamping.fit import Fit
from vaoi_station.errors import InputError
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import Component
from vaoi_station.model.stitch_result import BodyHeight, body_height

_POINTS = TypeAdapter(tuple[doc.ClampedPoint, ...])
_SIGMAS = 3.0
"""Standard deviations by which a keep-out solid is larger than the body, in all directions."""


_SPOTS = np.array([((1 - a) * (1 - b), a * (1 - b), a * b, (1 - a) * b) for a in (0, 0.5, 1) for b in (0, 0.5, 1)])
"""Shares (9, 4) of the corners of a footprint in its corners, middles of edges, and centre."""


class Wanted(NamedTuple):
    """A point that is asked for."""

    name: str
    at: tuple[float, float]
    """CAD coordinates."""
    board: str | None = None
    """Position of the board on the panel."""
    part: Component | None = None
    """The component that it is, or whose pad it is."""
    net: str | None = None
    """That of a test point; None for others."""


def wanted_points(film: FilmedBoard, request: doc.ClampedRequest) -> list[Wanted]:
    """Return the points that a request asks for, each test point once.

    Raises:
        InputError: the board type has no such name, or there are too many.
    """
    known = film.test_points
    if not known and (request.nets or request.pads_of or request.test_points):
        raise InputError(
            f"board type {film.board_type.name!r} has no test points.",
            action="Import its board data again, or with a netlist (--join).",
        )
    out, chosen = list[Wanted](), dict[str, None]()
    for point in request.points:
        if isinstance(point, doc.CadPoint):
            out.append(Wanted(point.name, (point.x, point.y), _text(point.board)))
        elif (part := film.parts.get(point)) is not None:
            out.append(Wanted(point, part.center, _text(part.panel), part))
        elif point in known:
            chosen[point] = None
            out.append(_test_point(film, point))
        elif (n := film.numbers.get(point)) is not None:
            mark = film.board_type.fiducials[n]
            out.append(Wanted(point, (mark.x, mark.y), _text(mark.panel)))
        else:
            limit = f"a test point, component or fiducial of board type {film.board_type.name!r}, or a point {{x, y}}"
            raise InputError.field("request", "points", point, limit)
    more = [name for name in _of_groups(film, request) if name not in chosen]
    if (count := len(out) + len(more)) > doc.MOST_POINTS:
        raise InputError.field("request", "the number of points", count, f"at most {doc.MOST_POINTS}")
    return out + [_test_point(film, name) for name in more]


def _of_groups(film: FilmedBoard, request: doc.ClampedRequest) -> dict[str, None]:
    """Return the names of the test points of the nets and components that are asked for, or of all."""
    by_net, by_part = defaultdict[str, list[str]](list), defaultdict[str, list[str]](list)
    if request.nets or request.pads_of:
        for name, (_, _, net) in film.test_points.items():
            by_net[net].append(name)
            by_part["" if (part := film.part_of(name)) is None else part.address].append(name)
    found = list(film.test_points) if request.test_points else []
    for key, wanted, listed in (("nets", request.nets, by_net), ("pads_of", request.pads_of, by_part)):
        for value in dict.fromkeys(wanted):
            if value not in listed:
                raise InputError.field("request", key, value, f"one with test points of {film.board_type.name!r}")
            found += listed[value]
    return dict.fromkeys(found)


def _test_point(film: FilmedBoard, name: str) -> Wanted:
    (x, y, net), part = film.test_points[name], film.part_of(name)
    board = name.partition("/")[0] if part is None else _text(part.panel)
    return Wanted(name, (x, y), board if part is not None or board in film.positions else None, part, net)


def _text(position: str | int | None) -> str | None:
    return None if position is None else str(position)


class Placing:
    """Where points of the board lie in the tester's coordinates."""

    def __init__(self, film: FilmedBoard, fits: Mapping[tuple[str, ...], Fit], bending: Bending, unit: str) -> None:
        self._film, self._bending, self._mm = film, bending, doc.MM_PER_UNIT[unit]
        self._whole = fits[()]
        self._boards = {key[1]: found for key, found in fits.items() if key[:1] == ("board",)}
        self._parts = {ref: found for key, found in fits.items() if key[:1] == ("parts",) for ref in key[1:]}

    def points(self, wanted: list[Wanted]) -> tuple[doc.ClampedPoint, ...]:
        """Return the answers to the points that were asked for."""
        if not wanted:
            return ()
        cad, mm = np.array([point.at for point in wanted]), self._mm
        at, sigma, slope, sigma_slope = self._placed(wanted, cad)
        z, sigma_z = self._bending.z_mm(cad), self._bending.sigma_mm(cad)
        columns = np.column_stack([at / mm, z / mm, slope, sigma / mm, sigma_z / mm, sigma_slope]).round(7).tolist()
        names = "x", "y", "z", "slope_x", "slope_y", "sigma_x", "sigma_y", "sigma_z", "sigma_slope"
        rows: list[dict[str, Any]] = [dict(zip(names, row, strict=True)) for row in columns]
        for point, row in zip(wanted, rows, strict=True):
            row["name"], row["net"] = point.name, point.net
            if point.part is not None and point.net is None:
                row.update(self._top(point.part, row["z"], row["sigma_z"]))
        return _POINTS.validate_python(rows)

    def _top(self, part: Component, z: float, sigma_z: float) -> dict[str, float | None]:
        height, mm = self._height(part), self._mm
        if height is None:
            return {}
        sigma = None if height.sigma_mm is None else round(math.hypot(height.sigma_mm / mm, sigma_z), 7)
        return {"top": round(z + height.mm / mm, 7), "sigma_top": sigma}

    def _height(self, part: Component) -> BodyHeight | None:
        return body_height(part, self._film.board_type, self._film.result)

    def _placed(self, wanted: list[Wanted], cad: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return places (k, 2), mm, with σ, and slopes (k, 2) with σ (k,); all of one board at once."""
        at, sigma, slope = np.empty((len(cad), 2)), np.empty((len(cad), 2)), np.empty((len(cad), 2))
        sigma_slope, groups = np.empty(len(cad)), dict[tuple[str | None, str | None], list[int]]()
        local = {*self._parts, *(self._film.result.local_matrices or {})}
        for n, point in enumerate(wanted):
            own = point.part.address if local and point.part is not None else None
            groups.setdefault((point.board, own if own in local else None), []).append(n)
        by_cad, sigma_by_cad = self._bending.slopes(cad)
        for (board, ref), mine in groups.items():
            found = self._parts.get(ref or "") or self._boards.get(board or "") or self._whole
            filmed = self._film.matrix(board) if ref is None else self._film.result.component_matrix(ref)
            matrix = found.matrix @ np.asarray(filmed, np.float64)
            at[mine] = apply(matrix, cad[mine])
            sigma[mine] = np.sqrt(found.variance(at[mine]) + self._film.place_sigma_mm**2)
            back = np.linalg.inv(matrix[:2, :2])
            slope[mine] = by_cad[mine] @ back
            sigma_slope[mine] = np.hypot(*sigma_by_cad[mine].T) * np.linalg.norm(back) / 2
        return at, sigma, slope, sigma_slope

    def keep_outs(self, clearance: float, margin: float) -> tuple[doc.KeepOut, ...]:
        """Return the bodies that may stand higher than the probe travels, with 3 σ and a margin, in the unit."""
        mm, chosen = self._mm, list[tuple[Component, BodyHeight | None]]()
        for part in self._film.board_type.components:
            height = self._height(part)
            high = height is not None and height.mm + _SIGMAS * (height.sigma_mm or 0.0) > clearance * mm
            if high or (height is None and part.fitted is not False):
                chosen.append((part, height))
        if not chosen:
            return ()
        wanted: list[Wanted] = [Wanted("", c, _text(p.panel), p) for p, _ in chosen for c in self._film.corners(p)]
        cad = np.array([point.at for point in wanted])
        at, sigma, slope, _ = self._placed(wanted, cad)
        # A bow may raise the board under the middle of a body above all its corners.
        spots = np.einsum("gk,nkc->ngc", _SPOTS, cad.reshape(-1, 4, 2)).reshape(-1, 2)
        z = (self._bending.z_mm(spots) + _SIGMAS * self._bending.sigma_mm(spots)).reshape(-1, len(_SPOTS)).max(1)
        corners, wide = at.reshape(-1, 4, 2), sigma.reshape(-1, 8).max(1)
        out = []
        for n, (part, height) in enumerate(chosen):
            tall = 0.0 if height is None else height.mm + _SIGMAS * (height.sigma_mm or 0.0)
            # On a slope, a body leans.
            lean = tall * float(np.hypot(*slope.reshape(-1, 4, 2)[n].mean(0)))
            grown = _grown(corners[n], margin * mm + _SIGMAS * float(wide[n]) + lean) / mm
            source: Literal["measured", "board-type", "unknown"] = "unknown" if height is None else height.source
            top = None if height is None else round((float(z[n]) + tall) / mm + margin, 6)
            corner = tuple(map(tuple, grown.round(6).tolist()))
            out.append(doc.KeepOut(component=part.address, corners=corner, top=top, source=source))
        return tuple(out)


def _grown(corners: Floats, margin: float) -> Floats:
    """Return a rectangle (4, 2), corners in turn, with a margin on every side."""
    along, across = corners[1] - corners[0], corners[3] - corners[0]
    along, across = margin * along / np.hypot(*along), margin * across / np.hypot(*across)
    return np.asarray(corners + np.array([-along - across, along - across, along + across, across - along]))
