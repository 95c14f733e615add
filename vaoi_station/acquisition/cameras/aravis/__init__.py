"""GigE Vision and USB3 Vision cameras through Aravis: frames are received directly into slots of the ring."""

from vaoi_station.acquisition.cameras.aravis.opening import open_aravis_cameras

__all__ = ["open_aravis_cameras"]
