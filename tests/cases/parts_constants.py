"""Constants of `vaoi_station.parts.probability`, and figures of measured parts, from painted boards of known truth.

`python -m tests.cases.parts_constants --good DIR … --bad DIR … [--boards N …] [--constants]`: recordings of
shared/cases/film.py with `--parts`, stitched (`result.json` beside them). Prints the figures of docs/measured/parts.md;
with `--constants` the constants that fit these boards.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.library.recordings import open_recording
from vaoi_station.parts import probability
from vaoi_station.parts.document import describe, scale_of
from vaoi_station.parts.learned import TaughtBoard, parts_digest
from vaoi_station.parts.measure import Evidence, Run, collect
from vaoi_station.parts.models import Models

Floats = NDArray[np.float64]


class Measured(NamedTuple):
    """The parts of one board with the truth, measured with some good boards."""

    boards: int
    truth: list[dict[str, Any]]
    evidence: Evidence
    scale: probability.Scale
    parts: list[dict[str, Any]]


def opened(case: Path) -> Run:
    """Open a stitched recording."""
    run = open_recording(case).with_result(case / "result.json")
    assert run.board_type is not None
    return Run(run.board_type, run.result, run.cameras, run.recording.head, lru_cache(96)(run.recording.frame))


def measured(good: Sequence[Path], bad: Sequence[Path], counts: Sequence[int]) -> list[Measured]:
    """Measure bad boards, each with the first of the good boards."""
    taught = []
    for path in good[: max(counts)]:
        run = opened(path)
        taught.append(
            TaughtBoard.of_run(path.name, run.cut(run.board_type.components), parts_digest(run.board_type), "")
        )
    out = []
    for count in counts:
        models = Models(taught[:count])
        for path in bad:
            run = opened(path)
            truth = json.loads((path / "truth.json").read_text())["parts"]
            patches, evidence = collect(run, models, run.board_type.components)
            parts = describe(patches, evidence)
            addresses = [p.address for p in patches.parts]
            out.append(Measured(
                count, [truth[a] for a in addresses], evidence, scale_of(patches, evidence),
                [parts[a] for a in addresses],
            ))  # fmt: skip
    return out


def interval(k: int, n: int) -> str:
    """Return k of n with the Wilson interval of 95 %."""
    if not n:
        return "0 of 0"
    z, p = 1.96, k / n
    middle, half = (
        (p + z * z / (2 * n)) / (1 + z * z / n),
        z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n),
    )
    return f"{k} of {n} ({100 * max(middle - half, 0):.2f} to {100 * min(middle + half, 1):.2f} %)"


def figures(found: Sequence[Measured]) -> None:
    """Print the figures of measured boards, by number of good boards."""
    for boards in sorted({m.boards for m in found}):
        pairs = [(t, p) for m in found if m.boards == boards for t, p in zip(m.truth, m.parts, strict=True)]
        said = [(t["kind"], p["presence"], t, p) for t, p in pairs if p["presence"] is not None]
        absent = [q for k, q, _, _ in said if k == "absent"]
        good = [q for k, q, _, _ in said if k == "good"]
        other = [q for k, q, _, _ in said if k not in ("good", "absent")]
        marked = [(k, p["orientation"]) for k, _, t, p in said if t.get("marked") and p["orientation"]]
        print(f"good boards {boards}: parts {len(pairs)}, cannot say {len(pairs) - len(said)}")
        print("  absent found", interval(sum(q < 0.5 for q in absent), len(absent)))
        print("  good marked absent", interval(sum(q < 0.5 for q in good), len(good)))
        print("  other present marked absent", interval(sum(q < 0.5 for q in other), len(other)))
        turned = [o.get("180", 0) > 0.5 for k, o in marked if k == "reversed"]
        print("  reversed found", interval(sum(turned), len(turned)))
        wrong = [o.get("180", 0) > 0.5 for k, o in marked if k in ("good", "shifted", "turned")]
        print("  right way round called reversed", interval(sum(wrong), len(wrong)))
        unmarked = [p["orientation"] is None for k, _, t, p in said if t.get("marked") is False]
        print("  cannot say which way round, without marks", interval(sum(unmarked), len(unmarked)))
        like = [p["alike"] < 0.5 for k, _, _, p in said if k == "exchanged"]
        print("  exchanged unlike", interval(sum(like), len(like)))
        print("  good unlike", interval(sum(p["alike"] < 0.5 for k, _, _, p in said if k == "good"), len(good)))
        for kinds in (("good",), ("shifted", "turned")):
            rows = [
                (p["dx_mm"] - t["dx"], p["dy_mm"] - t["dy"], p["sigma_mm"],
                 (p["turn_deg"] - t["turn_deg"] + 180) % 360 - 180, p["sigma_deg"])
                for k, _, t, p in said if k in kinds and p["dx_mm"] is not None
            ]  # fmt: skip
            if rows:
                e = np.array(rows)
                z, turn = e[:, :2] / e[:, 2:3], e[:, 3] / e[:, 4]
                print(
                    f"  {' and '.join(kinds)}: {len(e)}, place rms {np.sqrt(np.mean(e[:, :2] ** 2)):.4f} mm, σ "
                    f"{np.median(e[:, 2]):.4f}, error/σ {np.sqrt(np.mean(z**2)):.2f}, "
                    f"beyond 4 {np.mean(np.abs(z) > 4):.2%}; "
                    f"turn rms {np.sqrt(np.mean(e[:, 3] ** 2)):.2f}°, error/σ {np.sqrt(np.mean(turn**2)):.2f}, "
                    f"beyond 4 {np.mean(np.abs(turn) > 4):.2%}"
                )
        p = np.array([q for _, q, _, _ in said])
        y = np.array([k != "absent" for k, _, _, _ in said])
        for low in np.arange(0, 1, 0.1):
            here = (p >= low) & (p < low + 0.1 + (low > 0.85))
            if here.any():
                print(
                    f"  presence {low:.1f}: {here.sum()} parts, stated {p[here].mean():.3f}, true {y[here].mean():.3f}"
                )


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
    """Print figures or constants."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--good", nargs="+", type=Path, required=True)
    parser.add_argument("--bad", nargs="+", type=Path, required=True)
    parser.add_argument("--boards", nargs="+", type=int, default=[1, 5])
    parser.add_argument("--constants", action="store_true")
    given = parser.parse_args()
    found = measured(given.good, given.bad, given.boards)
    figures(found)
    if given.constants:
        constants(found)
        sigma_constants(found)


if __name__ == "__main__":
    main()
