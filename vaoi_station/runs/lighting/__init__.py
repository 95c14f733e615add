"""Light programs, checked before the line is armed; settings of a camera on trial while it is disarmed."""
