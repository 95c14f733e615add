"""Push: the events of the station, sent to receivers that do not ask for them.

One thread per receiver reads the event log by number and delivers every event it wants, in order, until the receiver
accepts it (`delivery`). How a message travels is the matter of a transport: `webhook_transport`, `mqtt_transport`. What
was delivered is on disk, so that a restart continues there. A receiver gets an event at least once, always with the
same id. The line calls nothing here, and a receiver that is slow, dead or hostile holds up its own thread only.
"""
