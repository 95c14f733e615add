"""Hands finished runs to an archive of the plant, in the time that the line leaves."""
