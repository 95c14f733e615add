"""The input of the checks."""

from __future__ import annotations

import pytest

from tests.doctor.conftest import with_aravis, with_config
from vaoi_station.acquisition.ring.ring_layout import RingLayout
from vaoi_station.doctor.check_context import CheckContext, RunningProcess


@pytest.mark.parametrize(
    ("pid", "description", "command"),
    [(4711, "process 4711", "ps -fp 4711"), (None, "a process of another user", "vaoi doctor …, as root")],
)
def test_a_running_process_is_described(pid: int | None, description: str, command: str) -> None:
    process = RunningProcess(pid)
    assert (process.description, process.inspect_command) == (description, command)


def test_layout_is_that_of_the_configuration(context: CheckContext) -> None:
    assert context.layout == RingLayout.of(context.config)


def test_only_aravis_cameras_are_real(context: CheckContext) -> None:
    assert context.real_cameras == ()
    config = with_aravis(context.config)
    assert with_config(context, config).real_cameras == config.cameras
