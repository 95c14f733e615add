"""Trigger commands survive their line format."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.rig.camera_process import DARK, TriggerCommand

COMMANDS = st.builds(
    TriggerCommand,
    st.integers(DARK, 10**6),
    st.integers(0, 2**63),
    st.floats(0, 8),
    st.floats(0, 1),
    st.none() | st.floats(0, 8),
)


@given(COMMANDS)
def test_a_command_equals_its_parsed_line(command: TriggerCommand) -> None:
    line = command.to_line()
    assert TriggerCommand.from_line(line) == command
    assert TriggerCommand.from_line(line + "\n") == command


@given(COMMANDS)
def test_a_line_is_one_line_of_six_words(command: TriggerCommand) -> None:
    assert command.to_line().splitlines() == [command.to_line()]
    assert command.to_line().split()[0] == "fire"
    assert len(command.to_line().split()) == 6


def test_defaults_are_a_whole_frame_in_the_rendered_light() -> None:
    assert TriggerCommand(7).to_line() == "fire 7 0 1.0 0.0 None"


@pytest.mark.parametrize(
    "line", ["fire", "fire 1 2 3", "fire 1 2 3 4", "fire one 0 1 0 None", "fire 1 0 bright 0 None", ""]
)
def test_a_malformed_line_is_refused(line: str) -> None:
    with pytest.raises(ValueError, match=r"unpack|invalid literal|could not convert"):
        TriggerCommand.from_line(line)
