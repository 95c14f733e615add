"""The caller of a request, as limits count it."""

from __future__ import annotations

from typing import Any

from vaoi_station.api.callers.caller import caller_in, set_caller


def test_a_caller_is_known_by_its_address() -> None:
    scope: dict[str, Any] = {"client": ("fd00::1", 4711), "state": {"app": 1}}
    assert set_caller(scope).name == "fd00::/64"
    assert caller_in(scope).name == "fd00::/64"
    assert scope["state"]["app"] == 1


def test_a_caller_without_an_address_is_local() -> None:
    assert set_caller({"client": None}).name == "local"
