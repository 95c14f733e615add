"""Stitch recordings on disk, and keep one as the reference of its board type."""
