"""`vaoi doctor`: whether this machine and its devices are fit for a station, and what to do where they are not.

It looks and changes nothing: no setting of a camera, no file, no parameter of the kernel. Where the station runs,
cameras and controller are the station's; it is asked over REST instead.
"""

from vaoi_station.doctor.finding import Finding, Level, Report
from vaoi_station.doctor.machine import Machine
from vaoi_station.doctor.runner import run_checks

__all__ = ["Finding", "Level", "Machine", "Report", "run_checks"]
