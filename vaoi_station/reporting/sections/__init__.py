"""The sections of the report. Each module makes one or two sections."""
