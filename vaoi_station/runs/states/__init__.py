"""Define states and schemas: the state tables, what the station reports, run ids."""
