"""Addresses of this machine. They may come later than the service starts: by a cable, a switch, or DHCP."""

from __future__ import annotations

import errno
import ipaddress
import socket


def is_present(host: str) -> bool:
    """Return whether an interface has an IP address now. For a host name, return True without looking it up."""
    try:
        version = ipaddress.ip_address(host).version
    except ValueError:
        return True
    with socket.socket(socket.AF_INET6 if version == 6 else socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((host, 0))
        except OSError as error:
            return error.errno != errno.EADDRNOTAVAIL
    return True
