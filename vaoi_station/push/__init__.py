"""Push: events of the station to a broker, by MQTT or as IPC-CFX, in order, at least once; the line waits for none."""
