"""Stitching of recordings on disk, and storage of a run as the reference of its board type."""
