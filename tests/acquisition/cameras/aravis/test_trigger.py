"""Recipes for the hardware trigger are found by the beginning of the vendor's name."""

from __future__ import annotations

import pytest

from vaoi_station.acquisition.cameras.aravis.settings import GENERIC, MAKES, make_of


@pytest.mark.parametrize(
    ("vendor", "make", "line"),
    [
        ("FLIR", "flir", "Line0"),
        ("Point Grey Research", "point grey", "Line0"),
        ("Teledyne FLIR", "teledyne", "Line0"),
        ("Basler", "basler", "Line1"),
        ("Lucid Vision Labs", "lucid", "Line2"),
        ("LUCID VISION LABS", "lucid", "Line2"),
        ("Aravis", "aravis", "Line0"),
    ],
)
def test_a_make_is_found_whatever_follows_its_name(vendor: str, make: str, line: str) -> None:
    assert make_of(vendor) is MAKES[make]
    assert make_of(vendor).line == line


@pytest.mark.parametrize("vendor", ["", "Unknown GmbH", "The Basler Company"])
def test_an_unknown_make_gets_the_recipe_that_all_cameras_accept(vendor: str) -> None:
    assert make_of(vendor) is GENERIC
    assert GENERIC.off_while_changing, "some cameras refuse another source while the mode is on"


def test_makes_are_written_as_they_are_compared() -> None:
    assert all(make == make.casefold() for make in MAKES)
