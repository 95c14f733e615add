"""The real trigger controller: the protocol over a serial port, supervised by one thread."""

from vaoi_station.acquisition.controller.serial.controller import SerialController

__all__ = ["SerialController"]
