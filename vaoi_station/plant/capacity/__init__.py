"""How large a plant is: rates, sizes and cost calculated from measured figures, and a simulation of the queue."""

from vaoi_station.plant.capacity.figures import Figures, Measured, Plant, figures
from vaoi_station.plant.capacity.queueing import Requests, Waits, simulate

__all__ = ["Figures", "Measured", "Plant", "Requests", "Waits", "figures", "simulate"]
