"""Addresses of this machine, which may come later than the service: a cable, a switch, DHCP."""

from __future__ import annotations

import errno
import ipaddress
import socket


def is_present(host: str) -> bool:
    """Return whether an interface has an IP address now. True for a host name, which is not looked up here."""
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
