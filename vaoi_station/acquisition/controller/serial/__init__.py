"""The real trigger controller: the protocol over a serial port, supervised by one thread."""

from vaoi_station.acquisition.controller.serial.controller import SerialController, open_serial_controller

__all__ = ["SerialController", "open_serial_controller"]
