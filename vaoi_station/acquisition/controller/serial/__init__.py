"""The real trigger controller: its firmware's protocol over a serial port."""

from vaoi_station.acquisition.controller.serial.controller import SerialController, open_serial_controller

__all__ = ["SerialController", "open_serial_controller"]
