"""A GigE camera whose address is of a foreign network: only broadcasts reach it until FORCEIP gives it another one."""

from __future__ import annotations

import math
import socket

from vaoi_station.rig.gige.device import ACCESS_DENIED, APPLICATION, PRIVILEGE, Device
from vaoi_station.rig.virtual_camera import OWN_DESCRIPTION, read_description

CONFIGURATION = 0x14


class ForeignCamera(Device):
    """The rig's camera on loopback; it takes its address from DHCP, or has a link-local one."""

    def __init__(self, serial: str, address: str = "10.9.8.7", model: str = "Foreign") -> None:
        text = read_description(OWN_DESCRIPTION).replace('"Virtual"', f'"{model}"').replace('"VAOI"', '"Test"')
        self.refuses: set[int] = set()
        """Registers whose writing the camera refuses."""
        super().__init__(address, text, serial=serial, foreign=True)
        self.set_number(CONFIGURATION, 0b110)

    def refusal(self, address: int) -> int:
        """Refuse what a test says."""
        return ACCESS_DENIED if address in self.refuses else super().refusal(address)

    def take(self, host: str = "") -> None:
        """Let an application on a computer control the camera, without a heartbeat."""
        self._heard_s = math.inf
        self.set_number(PRIVILEGE, 2)
        if host:
            self.registers.write(APPLICATION, socket.inet_aton(host))
