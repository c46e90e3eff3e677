"""The other side of the emScon wire as others wrote it: cesapi 1.1.3, generated from the maker's header.

Its simulator (``CESAPI.test``) tells counting numbers for whatever was set and never sends a result, so no driver
that reads back its settings can measure with it. ``PeerTracker`` keeps what was set and sends results, and every
byte of it is packed by cesapi's own classes.
"""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from copy import deepcopy
from typing import Any
from unittest import mock

from cellcal.fake_devices.listening_port import ListeningPort

with mock.patch("logging.basicConfig"):  # cesapi calls it when it is imported: the log is not its business
    from CESAPI import packet as ces
    from CESAPI.command import CommandSync
    from CESAPI.connection import Connection

_HEADER_BYTES = 8
_PER_METRE = {ces.ES_LU_Meter: 1.0, ces.ES_LU_Millimeter: 1e3}


def header_table(prefix: str) -> dict[str, int]:
    """Return one enumeration of the header as cesapi has it, names without their prefix."""
    found = {name: value for name, value in vars(ces).items() if name.startswith(prefix)}
    return {name.removeprefix(prefix): value for name, value in found.items()}


def _first_settings() -> dict[str, Any]:
    """Return what a tracker comes up with: millimetre and degree, spherical, everything applied."""
    units, flags = ces.SystemUnitsDataT(), ces.SystemSettingsDataT()
    units.lenUnitType, units.angUnitType = ces.ES_LU_Millimeter, ces.ES_AU_Degree
    flags.bApplyTransformationParams = flags.bApplyStationOrientationParams = flags.bTryMeasurementMode = 1
    version = ces.ESVersionNumberT()
    version.iMajorVersionNumber, version.iMinorVersionNumber, version.iBuildNumber = 3, 8, 900
    frame = ces.TransformationDataT()
    frame.dScale = 1.0
    return {
        "unitsSettings": units,
        "coordSysType": ces.ES_CS_SCW,
        "systemSettings": flags,
        "measMode": ces.ES_MM_Stationary,
        "stationaryMeasurements": ces.ES_SM_Standard,
        "iInternalReflectorId": 2,
        "iInternalCompensationId": 11,
        "stationOrientation": ces.StationOrientationDataT(),
        "transformationData": frame,
        "trackerStatus": ces.ES_TS_Ready,
        "trackerProcessorStatus": ces.ES_TPS_Booted,
        "esVersionNumber": version,
        "cTrackerName": "AT401".encode("utf-16-le"),
    }


class PeerTracker:
    """A tracker that stands still and sees its target at one place."""

    def __init__(self, serial: int, place_m: tuple[float, float, float]) -> None:
        self.place_m = place_m
        self.received: list[Any] = []
        self.refuses: dict[int, int] = {}  # command -> status
        self.instead: list[Any] | None = None  # packets that come in place of a result
        self.settings = {**_first_settings(), "lTrackerSerialNumber": serial}

    def take_packet(self, data: bytes) -> list[Any]:
        """Take one packet of the driver; return the packets that it is answered with."""
        command = ces.PacketFactory().packet(data, return_type=False)
        assert command.pack() == data, f"cesapi packs {type(command).__name__} otherwise"
        self.received.append(command)
        number = command.packetInfo.command
        reply = getattr(ces, type(command).__name__.removesuffix("CT") + "RT")()
        reply.packetInfo.status = self.refuses.get(number, ces.ES_RS_AllOK)
        if reply.packetInfo.status:
            return [reply]
        self._keep_settings(command)
        if number == ces.ES_C_Initialize:
            self.settings["trackerProcessorStatus"] = ces.ES_TPS_Initialized
        for name in self.settings.keys() & vars(reply).keys():
            setattr(reply, name, self.settings[name])
        return [reply] if number != ces.ES_C_StartMeasurement else [reply, *self._measurement_packets()]

    def _keep_settings(self, command: Any) -> None:
        self.settings |= {
            name: deepcopy(value)
            for name, value in vars(command).items()
            if name in self.settings and name != "packetInfo"
        }

    def _measurement_packets(self) -> list[Any]:
        if self.instead is not None:
            return self.instead
        covariances = self.settings["stationaryMeasurements"] == ces.ES_SM_Extended
        found = ces.SingleMeasResult2T() if covariances else ces.SingleMeasResultT()
        per_m = _PER_METRE[self.settings["unitsSettings"].lenUnitType]
        found.measMode, found.bIsTryMode = (
            self.settings["measMode"],
            self.settings["systemSettings"].bTryMeasurementMode,
        )
        found.dVal1, found.dVal2, found.dVal3 = (per_m * value for value in self.place_m)
        found.dStd1, found.dStd2, found.dStd3 = (per_m * value for value in (1e-6, 2e-6, 30e-6))
        found.dAprioriStd1, found.dAprioriStd2, found.dAprioriStd3 = (
            per_m * v for v in (20e-6, 21e-6, 22e-6)
        )
        if covariances:
            found.dAprioriCovar12, found.dAprioriCovar13, found.dAprioriCovar23 = 1e-11, -2e-11, 3e-11
        found.dTemperature, found.dPressure, found.dHumidity = 21.5, 990.0, 40.0
        return [status_change(ces.ES_SSC_MeasStatus_Busy), found, status_change(ces.ES_SSC_MeasStatus_Ready)]


def status_change(code: int) -> Any:
    """Return an event."""
    event = ces.SystemStatusChangeT()
    event.systemStatusChange = code
    return event


def error_packet(command: int, status: int) -> Any:
    """Return an error that is no answer."""
    found = ces.ErrorResponseT()
    found.command, found.status = command, status
    return found


@asynccontextmanager
async def serve_peer(tracker: PeerTracker) -> AsyncIterator[int]:
    """Serve one driver; return the port. What went wrong inside is raised at the end."""
    failures: list[Exception] = []

    async def serve_driver(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while True:
                head = await reader.readexactly(_HEADER_BYTES)
                header = ces.PacketHeaderT()
                header.unpack(head)
                rest = await reader.readexactly(header.lPacketSize - _HEADER_BYTES)
                writer.write(b"".join(packet.pack() for packet in tracker.take_packet(head + rest)))
        except (asyncio.IncompleteReadError, ConnectionError):
            return
        except Exception as failure:
            failures.append(failure)

    async with ListeningPort("127.0.0.1", 0, serve_driver) as port:
        yield port.port
    if failures:
        raise failures[0]


class PeerClient:
    """cesapi's client; blocking, to be used in a thread."""

    def __init__(self, port: int) -> None:
        self._connection = Connection()
        self._connection.connect("127.0.0.1", port)
        self.command = CommandSync(self._connection)

    def close_client(self) -> None:
        """Hang up and see its thread ended."""
        self._connection.disconnect()
