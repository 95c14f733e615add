"""What the station answers to a supervisory system: its capabilities and its configuration.

A supervisory system connects to the station, says who it is, and then hears of boards that arrive and depart.
"""

from __future__ import annotations

from vaoi_station.hermes.messages import VERSION, Message, listed
from vaoi_station.hermes.session import CONFIGURATION_ERROR, ERROR, notification
from vaoi_station.line_config import Hermes

_FEATURES = (
    "FeatureCheckAliveResponse",
    "FeatureBoardTracking",
    "FeatureQueryHermesCapabilities",
    "FeatureConfiguration",
)
_OPTIONAL = (
    "MessageCheckAliveResponse",
    "MessageBoardForecast",
    "MessageQueryBoardInfo",
    "MessageSendBoardInfo",
    "MessageBoardArrived",
    "MessageBoardDeparted",
)


def answer(message: Message, machine: str, config: Hermes) -> Message | None:
    """Return the answer to a message of a supervisory system; None if there is none."""
    match message.tag:
        case "SupervisoryServiceDescription":
            features = listed("SupportedFeatures", _FEATURES)
            return Message.of("SupervisoryServiceDescription", features, SystemId=machine, Version=VERSION)
        case "CheckAlive":
            return Message.of("CheckAlive", Type=2, Id=message.get("Id")) if message.get("Type") == "1" else None
        case "QueryHermesCapabilities":
            return Message.of("SendHermesCapabilities", listed("OptionalMessages", _OPTIONAL))
        case "GetConfiguration":
            return _configuration(machine, config)
        case "SetConfiguration":
            return notification(CONFIGURATION_ERROR, ERROR, "the neighbours are configured in station.toml only")
        case _:
            return None


def _configuration(machine: str, config: Hermes) -> Message:
    parts: dict[str, tuple[tuple[str, dict[str, str]], ...]] = {}
    port = None
    if config.upstream is not None:
        host, upstream_port = config.address(config.upstream)
        one = {"UpstreamLaneId": str(config.lane), "HostAddress": host, "Port": str(upstream_port)}
        parts["UpstreamConfigurations"] = (("UpstreamConfiguration", one),)
    if config.listen is not None:
        one = {"DownstreamLaneId": str(config.lane), "Port": str(config.address(config.listen)[1])}
        parts["DownstreamConfigurations"] = (("DownstreamConfiguration", one),)
    if config.supervisor is not None:
        port = config.address(config.supervisor)[1]
    return Message.of("CurrentConfiguration", parts, MachineId=machine, SupervisorySystemPort=port)
