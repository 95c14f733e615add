"""Open the digital twin in place of real line, cameras and controller."""

from __future__ import annotations

from vaoi_station.acquisition.cameras.simulated import SimulatedCamera
from vaoi_station.acquisition.controller.filming_plan import filming_plan
from vaoi_station.acquisition.controller.interface import EventQueue, TriggerPlan
from vaoi_station.acquisition.controller.simulated import SimulatedController
from vaoi_station.acquisition.device_clock import DeviceClock, simulated_clock
from vaoi_station.acquisition.devices import Devices
from vaoi_station.acquisition.simulated.line import SimulatedLine, accept_plan
from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError
from vaoi_station.simulation import Scenario, Twin, read_scenario
from vaoi_station.supervised_thread import SupervisedThread


class _ControllerWithLine(SimulatedController):
    """A simulated controller that starts the line when it is started, and closes the line when it is closed."""

    def __init__(self, clock: DeviceClock, line: SimulatedLine) -> None:
        super().__init__(clock, line)
        self._simulated_line = line

    def start(self, events: EventQueue) -> None:
        """Start the controller, then the line."""
        super().start(events)
        self._simulated_line.start(self, events)

    def threads(self) -> tuple[SupervisedThread, ...]:
        """Return the threads of controller and line."""
        return (*super().threads(), *self._simulated_line.threads())

    def close(self) -> None:
        """Close the line, then the controller."""
        self._simulated_line.close()
        super().close()


def open_simulated(config: StationConfig) -> Devices:
    """Open cameras, controller and line of `config.simulation`.

    Raises:
        InputError: the scenario does not fit this station.
    """
    assert config.simulation is not None
    twin = Twin(read_scenario(config.simulation.scenario))
    _check(twin.scenario, config)
    cameras = tuple(SimulatedCamera(n, simulated_clock(n), c.exposure_us) for n, c in enumerate(config.cameras))
    plan = scenario_plan(twin)
    clock = simulated_clock(-1)
    simulation, interlock = config.simulation, config.controller.interlock == "on"
    line = SimulatedLine(twin, plan, cameras, clock, simulation.boards, simulation.interval_s, interlock)
    return Devices(cameras, _ControllerWithLine(clock, line))


def scenario_plan(twin: Twin) -> TriggerPlan:
    """Return the trigger plan of a scenario."""
    return TriggerPlan.of(twin.line, twin.scenario.line.lights, twin.program)


def check_scenario(config: StationConfig) -> None:
    """Raise InputError for a scenario that is absent, invalid, or made for another station."""
    assert config.simulation is not None
    scenario = read_scenario(config.simulation.scenario)
    _check(scenario, config)
    accept_plan(filming_plan(config), scenario_plan(Twin(scenario)), scenario.lights)


def _check(scenario: Scenario, config: StationConfig) -> None:
    """Raise InputError if the scenario's cameras or line differ from station.toml."""
    where = config.simulation.scenario if config.simulation else "scenario"
    array, twin = scenario.array, Twin(scenario)
    pairs: list[tuple[str, object, object]] = [("array.cameras", array.cameras, len(config.cameras))]
    for n, camera in enumerate(config.cameras):
        width_px, height_px = array.frame_px(n)
        pairs += [
            ("array.width_px", width_px, camera.width),
            ("array.height_px", height_px, camera.height),
            ("array.bits", array.bits, 8 if camera.pixel_format == "Mono8" else 16),
        ]
    pairs.append(("its conveyor_mm_s", tuple(twin.line.conveyor_mm_s), tuple(map(float, config.line.conveyor_mm_s))))
    pairs.append(("line.barrier_mm", twin.line.barrier_mm, config.line.barrier_mm))
    for key, found, ours in pairs:
        if found != ours:
            raise InputError.field(where, key, found, f"{ours}, as in station.toml")
