"""The version of the software, importable by every module without the public API."""

__version__ = "0.1.0"
