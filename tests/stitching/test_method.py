"""The table of methods covers every name that the configuration accepts."""

from __future__ import annotations

from dataclasses import asdict
from typing import get_args

from vaoi_station.stitching.matching.evidence import METHODS, MethodName


def test_every_configured_name_but_that_of_the_paper_has_its_evidence() -> None:
    assert set(METHODS) <= set(get_args(MethodName))


def test_auto_uses_all_evidence_and_every_other_method_less() -> None:
    evidence = {name: {kind for kind, used in asdict(method).items() if used} for name, method in METHODS.items()}
    everything = evidence.pop("auto")
    assert everything == {"links", "marks", "fixture", "reference"}
    assert all(used and used < everything for used in evidence.values())
    assert len({frozenset(used) for used in evidence.values()}) == len(evidence)


def test_fixture_marks_are_detected_with_the_fiducials() -> None:
    assert all(method.marks for method in METHODS.values() if method.fixture)
