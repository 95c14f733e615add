"""What follows from a scenario."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from vaoi_station.errors import InputError
from vaoi_station.rig.chip import Pulse
from vaoi_station.rig.line import check_supported, lighting_of, min_interval_s, with_cameras
from vaoi_station.rig.rendering import RenderedBoard
from vaoi_station.simulation import Scenario
from vaoi_station.simulation.camera_array import ArraySection
from vaoi_station.simulation.scenario import (
    FaultSection,
    IgnoredTrigger,
    LightSection,
    LineSection,
    LostFrame,
)


def test_a_larger_array_sees_a_wider_board() -> None:
    scenario = Scenario()
    larger = with_cameras(scenario, 5)
    assert larger.array.cameras == 5
    assert larger.board.width_mm == pytest.approx(scenario.board.width_mm + 2 * scenario.array.pitch_mm, abs=1e-3)
    assert larger.board.name == "demo-5"
    assert with_cameras(scenario, None) is scenario
    assert with_cameras(scenario, 3) is scenario
    with pytest.raises(InputError, match="--cameras is 1, but must be enough to see a board of 8 mm"):
        with_cameras(scenario.model_copy(update={"board": scenario.board.model_copy(update={"width_mm": 70.0})}), 1)


def test_cameras_that_do_wrong_by_themselves_are_asked_for_by_faults() -> None:
    check_supported(Scenario(faults=FaultSection(lost_frames=(LostFrame(camera=0, row=1),))))
    with pytest.raises(InputError, match=r"faults\.ignored_triggers apply to the cameras of the in-process twin only"):
        check_supported(Scenario(faults=FaultSection(ignored_triggers=(IgnoredTrigger(camera=0, row=1),))))


def scenario_of(lights: tuple[str, ...], exposures_us: tuple[float, ...] = (250.0,)) -> Scenario:
    return Scenario(
        array=ArraySection(exposures_us=exposures_us),
        line=LineSection(lights=lights),
        lights={name: LightSection() for name in lights},
    )


def pulse(channels: tuple[int, ...], on_us: float) -> Pulse:
    return Pulse(0, 0, channels, on_us)


def test_every_light_has_a_channel() -> None:
    lighting = lighting_of(scenario_of(("ring", "low", "ring")))
    assert lighting.channels == {"ring": (0,), "low": (1,)}
    assert lighting.light_of(pulse((1,), 250.1)) == "low"
    assert lighting.brightness(pulse((1,), 250.1), 0) == 1.0
    assert lighting.light_of(pulse((0, 1), 250.0)) is None
    assert lighting.brightness(pulse((0, 1), 250.0), 0) == 0.0
    with pytest.raises(InputError, match="at most 4 different ones"):
        lighting_of(scenario_of(("a", "b", "c", "d", "e")))


def test_a_camera_sees_the_light_within_its_own_exposure() -> None:
    lighting = lighting_of(scenario_of(("ring",), (250.0, 1000.0)))
    assert lighting.brightness(pulse((0,), 1000.0), 0) == 1.0
    assert lighting.brightness(pulse((0,), 500.0), 1) == 0.5


@dataclass(frozen=True)
class Short(RenderedBoard):
    seconds: float = 0.0

    @property
    def duration_s(self) -> float:
        return self.seconds


def test_boards_do_not_come_faster_than_they_pass(boards: tuple[RenderedBoard, ...]) -> None:
    scenario = scenario_of(("ring",))
    assert min_interval_s(scenario, boards) == scenario.line.interval_s
    assert min_interval_s(scenario, [Short(boards[0].directory, 7.13), *boards]) == 8.0


def test_a_program_lights_each_row_for_its_time() -> None:
    lit = {"left": LightSection(), "right": LightSection()}
    steps = [{"light": "left", "on_us": 100.0}, {"light": "right"}]
    scenario = Scenario.model_validate({"lights": lit, "line": {"lights": ["left"]}, "program": steps})
    lighting = lighting_of(scenario)
    assert lighting.channels == {"left": (0,), "right": (1,)}
    assert [lighting.brightness(pulse((0,), on_us), 0, 0) for on_us in (100.0, 50.0)] == [1.0, 0.5]
    assert lighting.brightness(pulse((1,), 250.0), 0, 1) == 1.0
    assert lighting.brightness(pulse((0,), 200.0), 0, 2) == 2.0


def test_a_camera_whose_exposures_differ_follows_the_width_of_the_trigger() -> None:
    steps = [{"light": "left", "exposure_us": 100.0}, {"light": "left", "exposure_us": 400.0}]
    scenario = Scenario.model_validate(
        {"lights": {"left": LightSection()}, "line": {"lights": ["left"]}, "program": steps}
    )
    lighting = lighting_of(scenario)
    register_us = lighting.exposures_us[0]
    for row, width_us in enumerate((100.0, 400.0)):
        fired = Pulse(0, 0, (0,), 1000.0, width_us)
        assert lighting.brightness(fired, 0, row) == 1.0
        timed, by_width = lighting.brightnesses(fired, 0, row)
        assert timed == pytest.approx(register_us / width_us)
        assert by_width == 1.0
    assert lighting.brightness(Pulse(0, 0, (0,), 1000.0, 200.0), 0, 1) == 0.5
