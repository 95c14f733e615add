"""A held station whose cameras are real ones, and which takes another camera and calibration."""

from __future__ import annotations

from pathlib import Path

from tests.api.held.setup_files import setup_files
from tests.api.held_station import HeldStation
from vaoi_station.api.setup.station_files import StationFiles
from vaoi_station.config import read_config
from vaoi_station.drift.checks import RunCheck
from vaoi_station.drift.recalibrate import Proposal, calibrate_exchanged
from vaoi_station.errors import InputError, StateError
from vaoi_station.files import read_calibration
from vaoi_station.model import Calibration
from vaoi_station.runs.states.schemas import CalibrationStatus, CameraExchange, StationSnapshot
from vaoi_station.store.documents import digest_of

OLD = ("OLD-0", "OLD-1", "OLD-2")


class RealStation(HeldStation):
    """A held station whose cameras are real ones of a model, and which takes another camera and calibration."""

    files: StationFiles
    in_force: Calibration

    def __init__(self) -> None:
        super().__init__()
        self.models = ["Foreign"] * 3
        self.exchanged: list[tuple[int, str, str]] = []
        self.checks: list[RunCheck] = []

    def snapshot(self) -> StationSnapshot:
        seen = super().snapshot()
        known = zip(seen.cameras, OLD, self.models, strict=True)
        return seen.model_copy(
            update={"cameras": tuple(c.model_copy(update={"serial": s, "model": m}) for c, s, m in known)}
        )

    def calibration(self) -> CalibrationStatus:
        status = super().calibration()
        cameras = [
            camera.model_copy(update={"exchange": self._shown(camera.camera)})
            if camera.camera in self.in_force.uncalibrated
            else camera
            for camera in status.cameras
        ]
        digest = digest_of(self.in_force.model_dump_json())
        return status.model_copy(update={"digest": digest, "cameras": tuple(cameras)})

    def _shown(self, camera: int) -> CameraExchange:
        try:
            found = self.exchange_proposal().found
        except InputError as refusal:
            return CameraExchange(boards=len(self.checks), ready=False, message=refusal.message)
        x, y, turn = (float(v) for v in found.displacement_px[camera])
        sigma_px = float(found.sigma_px[camera].max())
        return CameraExchange(boards=1, ready=True, x_px=x, y_px=y, turn_px=turn, sigma_px=sigma_px)

    def require_disarmed(self) -> None:
        if self.armed is not None:
            raise StateError("The line is armed; nothing was changed.", code="line-armed")

    def exchange_camera(self, camera: int, serial: str, address: str, calibration: Calibration | None) -> None:
        self.require_disarmed()
        assert calibration is not None
        self.in_force = calibration
        self.exchanged.append((camera, serial, address))

    def exchange_proposal(self) -> Proposal:
        return calibrate_exchanged(self.in_force, self.files.config.heads, self.checks)

    def use_calibration(self, calibration: Calibration) -> None:
        self.in_force = calibration


def real_station(folder: Path) -> RealStation:
    """A station of three real cameras, of which cam1 is gone, with its files."""
    files = setup_files(folder)
    text = files.path.read_text().replace('[simulation]\nscenario = "scenario.toml"\n', "")
    for serial in OLD:
        text = text.replace("[[cameras]]\nname", f'[[cameras]]\nbackend = "aravis"\nserial = "{serial}"\nname', 1)
    files.path.write_text(text + '[controller]\nbackend = "serial"\n')
    station = RealStation()
    station.files = StationFiles(files.path, read_config(files.path))
    station.in_force = read_calibration(station.files.config.calibration)
    station.lose(1)
    return station
