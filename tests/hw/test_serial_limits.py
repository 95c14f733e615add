"""The station refuses what the firmware cannot do, and names the setting, its value and the limit."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.hw.emulated.host import PLAN, Host
from tests.hw.emulated.paced import PacedChip
from vaoi_station.acquisition.controller.serial import SerialController
from vaoi_station.config import ControllerConfig, LightConfig
from vaoi_station.errors import InputError, StateError


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"period_s": 0.004, "lights": ("low",)}, r"period_s is 0\.004, but must be at least 0\.005, a limit"),
        ({"period_s": 600.0}, r"period_s is 600\.0, but must be at most 536\.871, a limit"),
        ({"start_delay_s": 0.008}, r"start_delay_s is 0\.008, but must be at least 0\.009, a limit"),
        ({"tail_s": 0.0}, r"tail_s is 0\.0, but must be at least 0\.009, a limit"),
        ({"max_rows": 70000}, r"max_rows is 65535, but must be at most 65534"),
        ({"debounce_s": 2.0, "start_delay_s": 3.0, "tail_s": 3.0}, r"debounce_s is 2\.0, but must be at most 1, a"),
        ({"lights": ("top",) * 17}, r"controller\.order is .*, but must be at most 16 lights"),
        ({"lights": ("blue",)}, r"lights is 'blue', but must be one of \['top', 'low'\]"),
    ],
)  # fmt: skip
def test_plans_that_the_firmware_cannot_carry_out(host: Host, change: dict[str, object], complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        host.controller.arm(replace(PLAN, **change))  # type: ignore[arg-type]
    host.controller.arm(PLAN)
    assert len(host.run()) == 6


@pytest.mark.parametrize(
    ("light", "complaint"),
    [
        (LightConfig(channels=(0, 2), on_us=600.0), r"on_us is 600\.0, but must be 50 … 500 \(the lo.* channel 2"),
        (LightConfig(channels=(0,), on_us=1001.0), r"must be 50 … 1000 \(the longest pulse of channel 0"),
        (LightConfig(channels=(0,), on_us=20.0), r"on_us is 20\.0, but must be 50 … 1000 \(the shortest"),
        (LightConfig(channels=(4,), on_us=100.0), r"top\.channels is 4, but must be below 4, the number"),
    ],
)  # fmt: skip
def test_lights_beyond_the_limits_of_the_firmware(paced: PacedChip, light: LightConfig, complaint: str) -> None:
    controller = SerialController(ControllerConfig(backend="serial", port=str(paced.link), lights={"top": light}))
    try:
        with pytest.raises(InputError, match=complaint):
            controller.arm(PLAN)
        with pytest.raises(InputError, match=complaint):
            controller.fire_one()
    finally:
        controller.close()


def test_leds_that_are_hot_are_no_fault_of_the_device(paced: PacedChip) -> None:
    """1 ms of light needs 16 ms to cool down; pulses can be asked for faster than that."""
    config = ControllerConfig(
        backend="serial", port=str(paced.link), lights={"top": LightConfig(channels=(0,), on_us=1000.0)}
    )
    controller = SerialController(config)
    messages = set()
    try:
        for _ in range(100):
            try:
                controller.fire_one()
            except StateError as refusal:
                messages.add(refusal.message)
        controller.read_clock()
    finally:
        controller.close()
    assert "the LEDs have not cooled down." in messages
    assert messages <= {"the LEDs have not cooled down.", "the pulse before is still under way."}
