"""Paths under which a proxy offers the station."""

from __future__ import annotations

import pytest
from pydantic import TypeAdapter, ValidationError

from vaoi_station.model.root_path import OWN_PATHS, RootPath, is_root_path

CHECK = TypeAdapter(RootPath)


@pytest.mark.parametrize("path", ["/aoi", "/plant_1/line-3.a", "/~3/api", "/A/0", "/" + "a" * 199])
def test_paths_of_plain_names_are_accepted(path: str) -> None:
    assert CHECK.validate_python(path) == path
    assert is_root_path(path)


@pytest.mark.parametrize(
    "path",
    ["//evil.example", "/a//b", "/a/../b", "/.a", "/aoi/", "aoi", "/a b", "/ä", "/", "/a\n", "/a?b", "/a%2e", "/a'"],
)
def test_everything_else_is_refused_in_words(path: str) -> None:
    assert not is_root_path(path)
    with pytest.raises(ValidationError, match="must be a path such as /aoi"):
        CHECK.validate_python(path)


def test_a_path_has_at_most_200_characters() -> None:
    assert not is_root_path("/" + "a" * 200)
    with pytest.raises(ValidationError, match="at most 200 characters"):
        CHECK.validate_python("/" + "a" * 200)


@pytest.mark.parametrize("name", sorted(OWN_PATHS))
def test_addresses_of_the_station_stay_reachable(name: str) -> None:
    for path in (f"/{name}", f"/{name}/x"):
        with pytest.raises(ValidationError, match=f"must not begin with /{name}"):
            CHECK.validate_python(path)
