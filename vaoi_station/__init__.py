"""Inline Video-AOI station: films a board on its way into the tester and hands out its component images."""

__version__ = "0.1.0"
