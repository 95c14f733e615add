"""GigE Vision and USB3 Vision cameras through Aravis: frames are received directly into slots of the ring."""
