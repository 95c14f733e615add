"""Light programs: checked before the line is armed."""
