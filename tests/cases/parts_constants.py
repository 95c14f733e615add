"""Constants of `vaoi_station.parts.probability` that fit painted boards of known truth.

`python -m tests.cases.parts_constants DIR`: measures the choosing set of `tests.cases.parts_boards`, with 1 and 5 good
boards each.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.cases.parts_proof import Measured, measured
from vaoi_station.parts import probability
from vaoi_station.parts.measure import Evidence

Floats = NDArray[np.float64]


def logistic_fit(features: Floats, true: Floats, weight: Floats) -> Floats:
    """Return the coefficients of a logistic function, with a small penalty on all but the constant."""
    penalty = 0.05 * np.diag([0.0] + [1.0] * (features.shape[1] - 1))
    b = np.zeros(features.shape[1])
    for _ in range(60):
        p = 1 / (1 + np.exp(-features @ b))
        normal = (features * (weight * p * (1 - p) + 1e-9)[:, None]).T @ features + penalty
        b += np.linalg.solve(normal, features.T @ (weight * (true - p)) - penalty @ b)
    return b


def constants(found: Sequence[Measured]) -> None:
    """Print the constants that fit measured boards."""
    kind = np.array([t["kind"] for m in found for t in m.truth])
    e = Evidence(*(np.concatenate(values) for values in zip(*(m.evidence for m in found), strict=True)))
    known = np.isfinite(e.unlike)
    one = np.ones(len(kind))
    measured_, sigma = np.column_stack([e.lift, e.wide]), np.column_stack([e.lift_sigma, e.wide_sigma])
    heights = probability.height_evidence(measured_, sigma, e.lifts)
    features = probability.presence_features(e.unlike, e.other, heights)
    twice = np.where(kind == "absent", 2.0, 1.0)
    print("PRESENT =", logistic_fit(features[known], (kind[known] != "absent") * 1.0, twice[known]).round(3).tolist())
    alone = np.column_stack([one, probability.height_evidence(measured_, sigma, np.full(measured_.shape, np.nan))])
    print("HEIGHT_ALONE =", logistic_fit(alone[known], (kind[known] != "absent") * 1.0, one[known]).round(3).tolist())
    two = known & np.isin(kind, ("good", "exchanged"))
    balance = np.where(kind == "good", 1.0, (kind == "good").sum() / max((kind == "exchanged").sum(), 1))
    unlike = np.column_stack([one, np.clip(np.log(np.maximum(e.unlike, 1e-3)), 0, 6)])
    print("ALIKE =", logistic_fit(unlike[two], (kind[two] == "good") * 1.0, balance[two]).round(3).tolist())


def sigma_constants(found: Sequence[Measured]) -> None:
    """Print the constants of standard deviations with which errors of places and turns are most probable.

    Good parts count as much as those that are shifted or turned.
    """
    use = [
        (m, k, t, p)
        for m in found
        for k, (t, p) in enumerate(zip(m.truth, m.parts, strict=True))
        if t["kind"] in ("good", "shifted", "turned") and p["dx_mm"] is not None
    ]
    scale = probability.Scale(*(np.array([m.scale[n][k] for m, k, _, _ in use]) for n in range(7)))
    noise = np.array([(m.evidence.noise_mm[k], m.evidence.noise_deg[k]) for m, k, _, _ in use])
    error = np.array(
        [(p["dx_mm"] - t["dx"], p["dy_mm"] - t["dy"], (p["turn_deg"] - t["turn_deg"] + 180) % 360 - 180)
         for _, _, t, p in use]
    )  # fmt: skip
    moved = np.array([t["kind"] != "good" for _, _, t, _ in use])
    weight = np.where(moved, 1 / max(moved.sum(), 1), 1 / max((~moved).sum(), 1))
    for name, of, which in (("PLACE", error[:, :2], 0), ("TURN", error[:, 2:], 1)):
        best, least = np.array(getattr(probability, name), float), np.inf
        for step in (2.0, 1.4, 1.1, 1.03) * 3:
            for k in range(len(best)):
                for factor in (1.0, step, 1 / step):
                    tried = best.copy()
                    tried[k] = max(tried[k], 0.003) * factor
                    tried[4] = max(tried[4], 1.0)
                    setattr(probability, name, tuple(tried))
                    sigma = probability.sigmas(noise[:, 0], noise[:, 1], scale)[which]
                    cost = (np.log(sigma) + (of.T / sigma) ** 2 / 2).mean(0) @ weight
                    if cost < least - 1e-9:
                        best, least = tried, float(cost)
        setattr(probability, name, tuple(best))
        print(f"{name} =", best.round(3).tolist())


def main() -> None:
    """Print the constants."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("boards", type=Path)
    families = sorted((parser.parse_args().boards / "choosing").iterdir())
    found = [m for family in families for m in measured(family, (1, 5))]
    constants(found)
    sigma_constants(found)


if __name__ == "__main__":
    main()
