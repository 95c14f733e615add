"""Formulas and names of the makers give what their documents state."""

from __future__ import annotations

import pytest

from vaoi_station.acquisition.cameras.aravis.families import misnumbers_resends, raw_gain, usual_line


@pytest.mark.parametrize(
    ("model", "count", "lowest", "gain_db"),
    [
        ("acA1300-30gm", 850, 300, 19.745),  # AW00123402, table 30
        ("acA640-90gc", 1023, 190, 29.9047),  # the same
        ("piA640-210gm", 450, 0, 16.155),  # pilot, "Gain"
        ("acA2000-50gm", 512, 36, 23.06),  # AW00089317, table 30: 24.08 dB at 512, 1.02 dB at 36
        ("acA800-200gm", 272, 136, 6.02),  # MDSplus, ACA800
        ("scA1400-30gm", 500, 192, 12.1),  # scout light, example
        ("scA1400-30gm", 600, 0, 21.24),  # the same, second branch
    ],
)
def test_counts_of_a_gain_are_the_decibels_of_the_makers_manual(
    model: str, count: int, lowest: int, gain_db: float
) -> None:
    formula = raw_gain("Basler", model)
    assert formula is not None
    assert formula.db(count, lowest) == pytest.approx(gain_db, abs=0.02)
    assert formula.count(formula.db(count, lowest), lowest) == pytest.approx(count)


def test_a_gain_without_a_document_is_not_guessed() -> None:
    assert raw_gain("Basler", "acA2440-20gm") is None
    assert raw_gain("Acme", "acA1300-30gm") is None


@pytest.mark.parametrize(
    ("vendor", "sources", "line"),
    [
        ("Allied Vision Technologies", ("Freerun", "Line1", "Line2", "Software"), "Line1"),  # Mako, Manta, GT
        ("Allied_Vision_Technologies", ("Software", "Line0", "Line1"), "Line0"),  # Alvium
        ("PointGreyResearch", ("Software", "Line0", "Line1"), "Line0"),
        ("Basler", ("Software", "Line1", "Line2"), "Line1"),
        ("Teledyne DALSA", ("Line1", "Line2", "Software"), "Line1"),
        ("PCO AG", ("SoftTrigger", "ExtTrig", "ExtTrigAndAcqEnbl"), "ExtTrig"),
        ("Acme", ("Software",), ""),
    ],
)
def test_the_input_is_one_that_the_camera_offers(vendor: str, sources: tuple[str, ...], line: str) -> None:
    assert usual_line(vendor, sources) == line


@pytest.mark.parametrize(
    ("vendor", "model", "misnumbers"),
    [
        ("Point Grey Research", "Blackfly BFLY-PGE-14S2C", True),
        ("FLIR", "Blackfly BFLY-PGE-13H2M", True),
        ("FLIR", "Blackfly S BFS-PGE-50S4C", False),
        ("Basler", "acA2440-20gm", False),
    ],
)
def test_only_the_generation_of_311_is_not_trusted(vendor: str, model: str, misnumbers: bool) -> None:
    assert misnumbers_resends(vendor, model) is misnumbers
