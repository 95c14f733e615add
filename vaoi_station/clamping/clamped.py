"""Answer a tester that has clamped a board: where it lies now, and every point that was asked for."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np

from vaoi_station.clamping import documents as doc
from vaoi_station.clamping.bending import Bending
from vaoi_station.clamping.filmed import FilmedBoard
from vaoi_station.clamping.fit import SCALE, SHEAR, STRETCH, Fit, left_out
from vaoi_station.clamping.points import Placing, wanted_points
from vaoi_station.clamping.readings import MisfitError, Readings
from vaoi_station.geometry.transforms import apply
from vaoi_station.model import Reason, Status

_MOST_DISTANCES, _MOST_FOR_DISTANCES = 20, 24


def clamp(film: FilmedBoard, request: doc.ClampedRequest) -> doc.Clamped:
    """Return where the board of a run lies as the tester has clamped it, and the points that it asks for.

    Raises:
        InputError: a reading or a point names what the board type does not have, or a fiducial is read twice.
    """
    readings, wanted = Readings(film, request), wanted_points(film, request)
    answer = doc.Clamped(status=Status.FAILED, unit=request.unit, z_from="readings" if readings.with_z else "fiducials")
    if film.status is not Status.OK:
        message = f"the verdict of the run is {film.status}: {'; '.join(film.reasons)}"
        readings.add_reason("film-not-ok", message, "See the reasons of the run; film the board again.")
    if film.status is Status.FAILED:
        return answer.model_copy(update={"reasons": tuple(readings.reasons)})
    try:
        named = readings.assigned()
        whole, used = readings.fitted(named)
    except MisfitError as refusal:
        return answer.model_copy(update={"reasons": (*readings.reasons, Reason.of(refusal))})
    bending, regions = readings.heights(used), readings.regions(whole, named)
    readings.remark(whole, used, bending)
    every = {(): (whole, used), **regions}
    placing = Placing(film, {key: found for key, (found, _) in every.items()}, bending, request.unit)
    found = {
        "z_from": "readings" if readings.with_z else "fiducials",
        "status": Status.DEGRADED if readings.reasons else Status.OK,
        "reasons": tuple(readings.reasons),
        "remarks": tuple(readings.remarks),
        "transforms": tuple(_transform(readings, key, found, at) for key, (found, at) in every.items()),
        "residuals": _residuals(readings, whole, used, {n for _, at in every.values() for n in at}, bending),
        "distances": _distances(readings, used),
        "bend": _bend(readings, bending) if readings.with_z else None,
        "points": placing.points(wanted),
        "keep_outs": () if request.clearance is None else placing.keep_outs(request.clearance, request.margin),
    }
    return answer.model_copy(update=found)


def _r(value: float, digits: int = 7) -> float:
    return round(float(value), digits)


def _transform(readings: Readings, key: tuple[str, ...], found: Fit, used: list[int]) -> doc.ClampedTransform:
    mm, board = readings.mm, key[1] if key[:1] == ("board",) else None
    matrix = np.diag([1 / mm, 1 / mm, 1.0]) @ found.matrix @ readings.film.matrix(board)
    sigma, in_unit = np.sqrt(found.covariance.diagonal()), np.r_[1 / mm, 1 / mm, np.ones(4)]
    scale, stretch, shear = (
        doc.Strain(ppm=_r(1e6 * found.values[n], 2), sigma_ppm=_r(1e6 * sigma[n], 2)) for n in (SCALE, STRETCH, SHEAR)
    )
    return doc.ClampedTransform(
        board=board,
        components=key[1:] if key[:1] == ("parts",) else (),
        fiducials=tuple(readings.names[n] for n in used),
        matrix=tuple(map(tuple, matrix.tolist())),
        turn_deg=_r(math.degrees(math.atan2(matrix[1, 0], matrix[0, 0]))),
        pivot=tuple((found.pivot / mm).tolist()),
        covariance=tuple(map(tuple, (found.covariance * in_unit * in_unit[:, None]).tolist())),
        scale=scale,
        stretch=stretch,
        shear=shear,
    )


def _residuals(
    readings: Readings, whole: Fit, used: list[int], count: set[int], bending: Bending
) -> tuple[doc.ReadingResidual, ...]:
    at, mm = apply(whole.matrix, readings.place), readings.mm
    off, sigmas = readings.at - at, np.full(len(at), np.nan)
    sigmas = np.hypot(*off.T) / np.sqrt(readings.sigma**2 + whole.variance(at).mean(1))
    alone, sigmas[used] = left_out(whole, readings.place[used], readings.at[used], readings.sigma[used])
    off[used] = np.where(np.isfinite(alone), alone, off[used])
    above = readings.z - bending.z_mm(readings.film.cad[readings.of[readings.with_z]]) if readings.with_z else ()
    z = dict(zip(readings.with_z, above, strict=True))
    return tuple(
        doc.ReadingResidual(
            fiducial=name,
            x=_r(off[n, 0] / mm),
            y=_r(off[n, 1] / mm),
            z=_r(z[n] / mm) if n in z else None,
            sigmas=_r(sigmas[n], 2) if math.isfinite(sigmas[n]) else None,
            used=n in count,
        )
        for n, name in enumerate(readings.names)
    )


def _distances(readings: Readings, used: list[int]) -> tuple[doc.DistanceChange, ...]:
    out = []
    for a, b in combinations(used[:_MOST_FOR_DISTANCES], 2):
        filmed, read = (float(np.hypot(*(p[a] - p[b]))) / readings.mm for p in (readings.place, readings.at))
        sigma = float(np.hypot(readings.sigma[a], readings.sigma[b])) / readings.mm
        pair = readings.names[a], readings.names[b]
        out.append(doc.DistanceChange(fiducials=pair, filmed=_r(filmed), change=_r(read - filmed), sigma=_r(sigma)))
    return tuple(sorted(out, key=lambda d: -abs(d.change) / d.sigma)[:_MOST_DISTANCES])


def _bend(readings: Readings, bending: Bending) -> doc.Bend:
    values, sigma = (
        (v / readings.mm).round(7).tolist() for v in (bending.values, np.sqrt(np.diag(bending.covariance)))
    )
    return doc.Bend(tilt=values[1:3], bow_change=values[3:], sigma=sigma[3:])
