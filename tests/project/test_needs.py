"""When a verdict hangs on a session of tests."""

from __future__ import annotations

import pytest

from tests.needs import is_yes


@pytest.mark.parametrize("setting", ["1", "true", "True", "yes", "woodpecker"])
def test_a_machine_that_says_so_gives_verdicts(setting: str) -> None:
    assert is_yes(setting)


@pytest.mark.parametrize("setting", ["", " ", "0", "false", "FALSE", "no", "off"])
def test_a_desk_may_say_that_it_is_none(setting: str) -> None:
    assert not is_yes(setting)
