"""Paths under which a proxy offers the station."""

from __future__ import annotations

import pytest
from pydantic import TypeAdapter, ValidationError

from vaoi_station.model.root_path import OWN_PATHS, RootPath, is_root_path

CHECK = TypeAdapter(RootPath)


@pytest.mark.parametrize(
    "path",
    ["//evil.example", "/a//b", "/a/../b", "/.a", "/aoi/", "aoi", "/a b", "/ä", "/", "/a\n", "/a?b", "/a%2e", "/a'"],
)
def test_everything_else_is_refused_in_words(path: str) -> None:
    assert not is_root_path(path)
    with pytest.raises(ValidationError, match="must be a path such as /aoi"):
        CHECK.validate_python(path)


@pytest.mark.parametrize("name", sorted(OWN_PATHS))
def test_addresses_of_the_station_stay_reachable(name: str) -> None:
    for path in (f"/{name}", f"/{name}/x"):
        with pytest.raises(ValidationError, match=f"must not begin with /{name}"):
            CHECK.validate_python(path)
