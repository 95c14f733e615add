"""The digital twin: simulates board, line and cameras from one scenario file, with faults and with known truth.

Each frame is a pure function of time and seed. `docs/reference/twin.md` describes what is modelled and what is not.
"""

from vaoi_station.simulation.scenario import Scenario
from vaoi_station.simulation.scenario_files import find_scenario, read_scenario, scenario_path
from vaoi_station.simulation.twin import Passage, Twin

__all__ = ["Passage", "Scenario", "Twin", "find_scenario", "read_scenario", "scenario_path"]
