"""`vaoi doctor`: whether this machine and its devices are fit for a station, and what to do where they are not.

It looks and changes nothing: no setting of a camera, no file, no parameter of the kernel. Where the station runs,
cameras and controller are the station's; it is asked over REST instead.
"""

from vaoi_station.doctor.examination import examine
from vaoi_station.doctor.finding import Finding, Level, Report
from vaoi_station.doctor.machine import Machine

__all__ = ["Finding", "Level", "Machine", "Report", "examine"]
