"""Is the predicted uncertainty that of the real error? Boards whose truth is known, stitched and compared.

Of every view of a component the error e (px) is normalised by its predicted covariance Σ: eᵀ·Σ⁻¹·e / 2 is 1 on the
average where Σ is right, less where it is too careful, more where it is too sure. Places of components do not
depend on the gauge. The errors of one run are correlated (all views share C), so a run counts once, by its mean.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from vaoi_station.benchmarks.frames import Material, of_recording
from vaoi_station.errors import InputError
from vaoi_station.geometry.transforms import Floats
from vaoi_station.simulation import Scenario, Twin, read_scenario, scenario_path
from vaoi_station.stitching.adjustment.surface import basis
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.quality.uncertainty import surface_sigma_mm
from vaoi_station.stitching.work import TaskRunner, all_tasks

FIRST_SEED = 3000
"""Of the runs that are measured; the model was fitted to others."""


@dataclass(frozen=True, eq=False)
class Run:
    """One board: what its views are off, and what was predicted."""

    name: str
    status: str
    error_px: Floats
    """(k, 2) of every view of a component."""
    covariance_px2: Floats
    """(k, 2, 2) as predicted."""
    surface_error_mm: Floats
    """(k,) height of the board under every component, estimated less true; empty where the truth is not known."""
    surface_sigma_mm: Floats

    @property
    def distance(self) -> Floats:
        """(k,) length of every error in standard deviations."""
        e, s = self.error_px, self.covariance_px2
        return np.asarray(np.sqrt(np.einsum("ki,kij,kj->k", e, np.linalg.inv(s), e)))

    @property
    def normalised(self) -> float:
        """Mean normalised squared error per degree of freedom."""
        return float((self.distance**2).mean() / 2)

    @property
    def rms_px(self) -> float:
        """Of the errors' length."""
        return float(np.sqrt((self.error_px**2).sum(1).mean()))

    @property
    def predicted_rms_px(self) -> float:
        """What it should be, by the covariances."""
        return float(np.sqrt(np.trace(self.covariance_px2, axis1=1, axis2=2).mean()))

    @property
    def line(self) -> str:
        """For a reader who waits."""
        figures = f"{self.rms_px:.4f} px, predicted {self.predicted_rms_px:.4f}" if len(self.error_px) else "no C"
        return f"{self.name:24s} {self.status:9s} {figures}"


@dataclass(frozen=True)
class Consistency:
    """What some runs say together."""

    runs: int
    failed: int
    normalised_mean: float
    normalised_median: float
    beyond_three: float
    """Share of views whose error is longer than 3 standard deviations: 1.1 % of normal errors in two dimensions."""
    worst: float
    """The longest error, in standard deviations."""
    surface_normalised: float | None
    """The same measure of the board's height under its components."""

    def document(self) -> dict[str, Any]:
        """For JSON, rounded."""
        return {k: round(v, 3) if isinstance(v, float) else v for k, v in vars(self).items()}


def together(runs: Sequence[Run]) -> Consistency:
    """The figures of several runs; those without C count as failed and nowhere else."""
    good = [r for r in runs if len(r.error_px)]
    if not good:
        raise InputError(f"none of {len(runs)} boards was found, so there is nothing to compare.")
    each = np.array([r.normalised for r in good])
    distances = np.concatenate([r.distance for r in good])
    heights = [float(((r.surface_error_mm / r.surface_sigma_mm) ** 2).mean()) for r in good if len(r.surface_error_mm)]
    return Consistency(
        runs=len(good),
        failed=len(runs) - len(good),
        normalised_mean=float(each.mean()),
        normalised_median=float(np.median(each)),
        beyond_three=float((distances > 3).mean()),
        worst=float(distances.max()),
        surface_normalised=float(np.mean(heights)) if heights else None,
    )


def _untold(line: str) -> None:
    """Nobody wants to know."""


def twin_runs(count: int, first_seed: int = FIRST_SEED, tell: Callable[[str], object] = _untold) -> Iterable[Run]:
    """Boards of the twin, each with its own array, board, belt, light and noise."""
    for seed in range(first_seed, first_seed + count):
        twin = Twin(varied(seed))
        passage = twin.passage(0)
        head, truth = passage.head(), passage.truth()
        frames = passage.render_all()
        material = Material(f"seed {seed}", head, twin.calibration, twin.board_type, frames, truth)
        places = np.array([p.place for p in twin.parts])
        heights = dict(zip([p.ref for p in twin.parts], twin.scene.surface_z(places), strict=True))
        run = run_of(material, {ref: float(mm) for ref, mm in heights.items()})
        tell(run.line)
        yield run


def recordings_with_truth(directory: Path) -> list[Path]:
    """Recordings in a directory that have a board and a truth, in the order of names."""
    return sorted(p.parent for p in directory.glob("*/truth.json") if (p.parent / "board.json").is_file())


def recorded_runs(recordings: Iterable[Path], tell: Callable[[str], object] = _untold) -> Iterable[Run]:
    """Recordings with their truth."""
    for case in recordings:
        truth = json.loads((case / "truth.json").read_text(encoding="utf-8"))
        run = run_of(replace(of_recording(case), truth=truth))
        tell(run.line)
        yield run


def run_of(material: Material, surface_mm: dict[str, float] | None = None) -> Run:
    """Stitch one board and compare.

    Args:
        material: with its truth.
        surface_mm: true height of the board under every component, where it is known.
    """
    assert material.truth is not None
    runner = TaskRunner(material.setup, lambda i, j: material.frames.get((i, j)))
    present, times_s = sorted(material.frames), material.head.row_times_s()
    tasks = all_tasks(present, dict(enumerate(times_s)), material.setup)
    stitch, findings = runner.conclude_with_findings(times_s, present, [runner.perform(task) for task in tasks])
    ours = {(ref, i, j): (x, y) for ref, views in (stitch.components or {}).items() for i, j, x, y in views}
    errors, covariances = [], []
    for ref, views in material.truth["views"].items():
        for i, j, x, y in views:
            covariance = findings.sigma.views.get(ref, {}).get((i, j))
            if covariance is not None:
                errors.append(np.subtract(ours[ref, i, j], (x, y)))
                covariances.append(covariance)
    off, sigma = _surface(findings, surface_mm or {})
    return Run(
        material.name,
        stitch.status.value,
        np.array(errors).reshape(-1, 2),
        np.array(covariances).reshape(-1, 2, 2),
        off,
        sigma,
    )


def _surface(findings: Findings, true_mm: dict[str, float]) -> tuple[Floats, Floats]:
    """Errors and standard deviations (k,) mm of the board's height under its components."""
    plane, adjusted = findings.plane, findings.adjusted
    if plane is None or not len(adjusted.surface_mm) or not true_mm:
        return np.zeros(0), np.zeros(0)
    parts = [p for p in plane.board_type.components if p.address in true_mm]
    cad = np.array([p.center for p in parts])
    found = basis(plane.board_type, cad) @ adjusted.surface_mm
    return found - [true_mm[p.address] for p in parts], surface_sigma_mm(plane, adjusted, cad)


def varied(seed: int) -> Scenario:
    """A scenario of small frames in which everything that may differ from board to board does.

    Noise, exposure, focus, vignetting, lenses, mounting; speed, slip, sway and yaw; lift, tilt and bow; lamp, shadow.
    """
    g = np.random.default_rng([seed, 9001])

    def between(low: float, high: float) -> float:
        return float(g.uniform(low, high))

    plain = read_scenario(scenario_path("small"))
    array = {
        "seed": int(g.integers(1_000_000)),
        "cameras": int(g.integers(2, 4)),
        "overlap": between(1.12, 1.2),
        "px_per_mm": between(16, 20),
        "distortion_px": between(0, 0.6),
        "gain": between(0.6, 1.1),
        "psf_px": between(0.5, 1.1),
        "read_noise": between(0.8, 3),
        "shot_noise": between(0.01, 0.06),
        "vignetting": between(0, 0.4),
        "flicker": between(0, 0.03),
    }
    belt = {
        "seed": int(g.integers(1_000_000)),
        "speed_error": float(g.normal(0, 0.008)),
        "speed_wander": between(0, 0.02),
        "sway_mm": between(0, 0.1),
        "yaw_wander_deg": between(0, 0.08),
    }
    board = {
        "seed": int(g.integers(1_000_000)),
        "density": between(1, 2.5),
        "lift_mm": float(g.normal(0, 0.3)),
        "bow_mm": float(g.normal(0, 0.15)),
        "tilt_mm": (float(g.normal(0, 0.05)), float(g.normal(0, 0.05))),
    }
    light = {"azimuth_deg": between(-180, 180), "shading": between(0, 0.3), "shadow": between(0, 0.4)}
    return plain.model_copy(
        update={
            "array": plain.array.model_copy(update=array),
            "belt": plain.belt.model_copy(update=belt),
            "board": plain.board.model_copy(update=board),
            "lights": {name: lamp.model_copy(update=light) for name, lamp in plain.lights.items()},
        }
    )
