"""The error of a reference in the result, by the weight that the reference has in C."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.stitching.adjustment.problem import REFERENCE, FiducialPoints
from vaoi_station.stitching.quality.uncertainty import reference_share, with_common_error
from vaoi_station.stitching.work import TaskRunner


def points(which: list[int], sigma_px: list[float]) -> FiducialPoints:
    k, resolution = len(which), np.full(len(which), 20.0)
    pairs, none = np.zeros((k, 2)), np.zeros(k, int)
    sigma = np.array(sigma_px) / 20.0
    return FiducialPoints(none, pairs, pairs, pairs, sigma, resolution, np.array(which), none)


def test_the_share_is_that_of_the_information() -> None:
    p = points([0, 1, REFERENCE, REFERENCE], [0.1, 0.1, 0.1, 0.1])
    residuals = np.zeros((4, 2))
    assert reference_share(p, residuals) == pytest.approx(0.5)
    residuals[3] = (5.0, 0.0)
    assert reference_share(p, residuals) == pytest.approx(1 / 3), "an outlier has no weight"
    assert reference_share(points([REFERENCE], [0.03]), np.zeros((1, 2))) == 1
    assert reference_share(points([0], [0.03]), np.zeros((1, 2))) == 0
    assert reference_share(None, np.zeros((0, 2))) == 0
    assert reference_share(FiducialPoints.empty(), np.zeros((0, 2))) == 0


def test_a_common_error_widens_every_position(filmed: Any) -> None:
    runner = TaskRunner(filmed.setup, filmed.frame)
    evidence = [runner.perform(task) for task in filmed.tasks]
    _, findings = runner.conclude_with_findings(filmed.times_s, filmed.present, evidence)
    plain = findings.sigma
    wide = with_common_error(plain, 0.1)
    assert plain.worst_px is not None
    assert wide.worst_px == pytest.approx(np.hypot(plain.worst_px, 0.1))
    assert wide.rows_px == pytest.approx(tuple(np.hypot(v, 0.1) for v in plain.rows_px))
    name = next(iter(plain.of_components))
    assert wide.of_components[name] == pytest.approx(np.hypot(plain.of_components[name], 0.1), abs=1e-4)
