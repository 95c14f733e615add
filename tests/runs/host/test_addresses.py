"""Addresses that an interface has, and one that none has."""

from __future__ import annotations

import pytest

from vaoi_station.runs.host.addresses import is_present


@pytest.mark.parametrize("host", ["127.0.0.1", "::", "station.example"])
def test_addresses_of_this_machine_and_names_are_present(host: str) -> None:
    assert is_present(host)


@pytest.mark.parametrize("host", ["192.0.2.77", "2001:db8::77"])
def test_addresses_for_documentation_are_not(host: str) -> None:
    assert not is_present(host)
