"""Push: the events of the station, published to an MQTT broker in order and at least once; the line waits for none."""
