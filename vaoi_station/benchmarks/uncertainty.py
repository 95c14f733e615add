"""Compare predicted uncertainty with real errors, on stitched boards with known truth.

The measure is the normalised squared error of each view of a component: for an error e (px) with predicted covariance
Σ it is eᵀ·Σ⁻¹·e / 2. Its mean is 1 if Σ is right, below 1 if Σ is too large, above 1 if Σ is too small. Positions of
components in frames do not depend on the gauge. The errors of one run are correlated, because all its views share C;
therefore each run contributes one value: the mean over its views.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from vaoi_station.benchmarks.boards import BenchmarkBoard, board_from_recording
from vaoi_station.errors import InputError
from vaoi_station.files.documents import read_json
from vaoi_station.geometry.transforms import Floats
from vaoi_station.simulation import Scenario, Twin, read_scenario, scenario_path
from vaoi_station.stitching.adjustment.problem import basis
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.quality.uncertainty import surface_sigma_mm
from vaoi_station.stitching.work import TaskRunner, all_tasks

FIRST_SEED = 3000
"""First seed of the measured boards; the noise model was fitted to boards with other seeds."""


@dataclass(frozen=True, eq=False)
class RunErrors:
    """Real errors of one stitched board, with their predicted covariances."""

    name: str
    status: str
    error_px: Floats
    """(k, 2) error of each of the k views of components, px."""
    covariance_px2: Floats
    surface_error_mm: Floats
    """Error of the surface height under each component, one value per component; empty if the truth is not known."""
    surface_sigma_mm: Floats

    @property
    def distance(self) -> Floats:
        """(k,) Mahalanobis length of each error: its length in standard deviations."""
        e, s = self.error_px, self.covariance_px2
        return np.asarray(np.sqrt(np.einsum("ki,kij,kj->k", e, np.linalg.inv(s), e)))

    @property
    def normalised(self) -> float:
        """Mean of the normalised squared errors of all views of the run."""
        # Two degrees of freedom: x and y.
        return float((self.distance**2).mean() / 2)

    @property
    def rms_px(self) -> float:
        """Root mean square of the lengths of the errors."""
        return float(np.sqrt((self.error_px**2).sum(1).mean()))

    @property
    def predicted_rms_px(self) -> float:
        """Root mean square length of the errors as the covariances predict it."""
        return float(np.sqrt(np.trace(self.covariance_px2, axis1=1, axis2=2).mean()))

    @property
    def summary(self) -> str:
        """One line of text with real and predicted errors, to show progress."""
        figures = f"{self.rms_px:.4f} px, predicted {self.predicted_rms_px:.4f}" if len(self.error_px) else "no C"
        return f"{self.name:24s} {self.status:9s} {figures}"


@dataclass(frozen=True)
class Consistency:
    """Summary of the real and predicted errors of several runs."""

    runs: int
    failed: int
    """Number of runs without a CAD matrix; they are not part of the other figures."""
    normalised_mean: float
    normalised_median: float
    beyond_three: float
    """Share of views with an error above 3 standard deviations: exp(−9/2) = 1.1 % for normal errors in the plane."""
    worst: float
    surface_normalised: float | None
    """Mean of the squared errors of the surface height over their variances; None if no true surface is known."""

    def document(self) -> dict[str, Any]:
        """Return the rounded figures as a dictionary for JSON."""
        return {k: round(v, 3) if isinstance(v, float) else v for k, v in vars(self).items()}


def summarise_runs(runs: Sequence[RunErrors]) -> Consistency:
    """Summarise the real and predicted errors of several runs; raise InputError if none has a CAD matrix."""
    good = [r for r in runs if len(r.error_px)]
    if not good:
        raise InputError(f"none of {len(runs)} boards has a CAD mapping, so there is nothing to compare.")
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


def twin_runs(
    count: int, first_seed: int = FIRST_SEED, report: Callable[[str], object] = lambda _: None
) -> Iterable[RunErrors]:
    """Render and stitch boards of the twin, each with random parameters; yield their errors."""
    for seed in range(first_seed, first_seed + count):
        twin = Twin(random_scenario(seed))
        passage = twin.passage(0)
        head, truth = passage.head(), passage.truth()
        frames = passage.render_all()
        board = BenchmarkBoard(f"seed {seed}", head, twin.calibration, twin.board_type, frames, truth)
        places = np.array([p.place for p in twin.parts])
        heights = dict(zip([p.ref for p in twin.parts], twin.scene.surface_z(places), strict=True))
        run = compare_with_truth(board, {ref: float(mm) for ref, mm in heights.items()})
        report(run.summary)
        yield run


def recordings_with_truth(directory: Path) -> list[Path]:
    """Return the recordings in a directory that have both a board type and a truth file, sorted by name."""
    return sorted(p.parent for p in directory.glob("*/truth.json") if (p.parent / "board.json").is_file())


def recorded_runs(recordings: Iterable[Path], report: Callable[[str], object]) -> Iterable[RunErrors]:
    """Stitch recordings, compare each with its truth file, and yield the errors."""
    for case in recordings:
        # A truth file holds no true surface, so only positions are compared.
        truth = read_json(case / "truth.json")
        run = compare_with_truth(replace(board_from_recording(case), truth=truth))
        report(run.summary)
        yield run


def compare_with_truth(board: BenchmarkBoard, surface_mm: dict[str, float] | None = None) -> RunErrors:
    """Stitch one board and return the errors of its component positions and, by address, of surface heights."""
    assert board.truth is not None
    runner = TaskRunner(board.setup, board.frame)
    present, times_s = sorted(board.frames), board.head.row_times_s()
    tasks = all_tasks(present, dict(enumerate(times_s)), board.setup)
    stitch, findings = runner.conclude_with_findings(times_s, present, [runner.perform(task) for task in tasks])
    found = {(ref, i, j): (x, y) for ref, views in (stitch.components or {}).items() for i, j, x, y in views}
    errors, covariances = [], []
    for ref, views in board.truth["views"].items():
        for i, j, x, y in views:
            covariance = findings.sigma.views.get(ref, {}).get((i, j))
            # Without a covariance the run has no such view: the frame has no matrix, or C was not found.
            if covariance is not None:
                errors.append(np.subtract(found[ref, i, j], (x, y)))
                covariances.append(covariance)
    surface_error, surface_sigma = _surface(findings, surface_mm or {})
    return RunErrors(
        board.name,
        stitch.status.value,
        np.array(errors).reshape(-1, 2),
        np.array(covariances).reshape(-1, 2, 2),
        surface_error,
        surface_sigma,
    )


def _surface(findings: Findings, true_mm: dict[str, float]) -> tuple[Floats, Floats]:
    """Return the errors of the surface height under k components, (k,), mm, and their predicted standard deviations."""
    plane, adjusted = findings.plane, findings.adjusted
    if plane is None or not len(adjusted.surface_mm) or not true_mm:
        return np.zeros(0), np.zeros(0)
    parts = [p for p in plane.board_type.components if p.address in true_mm]
    cad = np.array([p.center for p in parts])
    found = basis(plane.board_type, cad) @ adjusted.surface_mm
    return found - [true_mm[p.address] for p in parts], surface_sigma_mm(plane, adjusted, cad)


def random_scenario(seed: int) -> Scenario:
    """Return a scenario of small frames whose parameters are drawn at random from realistic ranges."""
    # The second number makes these random numbers independent of those that the twin derives from the same seed.
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
