"""The plot of predicted and real errors."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from tests.benchmarks.accuracy.error_samples import normal_errors, without_cad_matrix
from vaoi_station.benchmarks.accuracy.consistency import RunErrors
from vaoi_station.benchmarks.accuracy.consistency_plot import draw_consistency

SVG = "{http://www.w3.org/2000/svg}"


def drawn(twin: list[RunErrors], recorded: list[RunErrors]) -> ElementTree.Element:
    return ElementTree.fromstring(draw_consistency(twin, recorded))


def centres(root: ElementTree.Element) -> list[tuple[float, float]]:
    return [(float(c.attrib["cx"]), float(c.attrib["cy"])) for c in root.iter(f"{SVG}circle")]


def test_each_run_with_a_cad_matrix_is_one_point() -> None:
    twin = [normal_errors(seed, 0.01, 0.01, 50) for seed in range(3)]
    root = drawn([*twin, without_cad_matrix()], [normal_errors(9, 0.02, 0.01, 50)])
    assert len(centres(root)) == 4
    assert {"twin", "recordings"} <= {t.text for t in root.iter(f"{SVG}text")}


def test_larger_predictions_lie_further_right_and_larger_errors_higher() -> None:
    errors_px = ((0.005, 0.005), (0.005, 0.01), (0.01, 0.005))
    low, right, high = centres(drawn([normal_errors(1, real, predicted) for real, predicted in errors_px], []))
    assert right[0] > low[0]
    assert right[1] == pytest.approx(low[1])
    assert high[1] < low[1]
    assert high[0] == pytest.approx(low[0])


def test_errors_beyond_the_axes_are_drawn_at_their_ends() -> None:
    tiny, small = centres(drawn([normal_errors(1, 1e-6, 1e-6, 50), normal_errors(2, 1e-5, 1e-5, 50)], []))
    assert tiny == small


def test_distribution_of_normal_errors_follows_the_dashed_curve() -> None:
    """Lengths of normal errors in two dimensions have a Rayleigh distribution."""
    root = drawn([normal_errors(1, 0.01, 0.01)], [])
    lines = [p.attrib["points"].split() for p in root.iter(f"{SVG}polyline")]
    expected, measured = ([float(p.split(",")[1]) for p in line] for line in lines if len(line) > 2)
    height = max(expected) - min(expected)
    assert max(abs(a - b) for a, b in zip(expected, measured, strict=True)) < 0.03 * height
