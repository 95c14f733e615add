"""Check whether this machine and its devices can run a station (`vaoi doctor`), and propose an action for each problem.

The checks change nothing: no camera setting, no file, no kernel parameter. While a station runs, it owns cameras and
controller; the checks then read their state from its REST service.
"""

from vaoi_station.doctor.finding import Finding, Level, Report
from vaoi_station.doctor.machine import Machine
from vaoi_station.doctor.runner import run_checks

__all__ = ["Finding", "Level", "Machine", "Report", "run_checks"]
