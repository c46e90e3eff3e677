"""The emScon wire against code of others: our driver with cesapi's packets, and cesapi's client with our fake."""

import asyncio
import csv
import re
from collections.abc import AsyncIterator
from importlib import resources
from typing import Any

import numpy as np
import pytest

from cellcal.drivers.errors import RefusedError, WrongDeviceError
from cellcal.drivers.interfaces import Readiness
from cellcal.drivers.laser_tracker.config import LaserTrackerConfig
from cellcal.drivers.laser_tracker.packets import StatusChange, TrackerCommand
from cellcal.fake_devices.laser_tracker.device import FakeLaserTracker as FakeTracker
from tests.machine_speed import stretched_s
from tests.wire.cesapi_peer import (
    PeerClient,
    PeerTracker,
    ces,
    error_packet,
    header_table,
    serve_peer,
    status_change,
)
from tests.wire.tracker_cases import SERIAL, believed_position, fake_tracker

PLACE_M = (2.125, -0.75, 0.5)


def driver_at(port: int, **changes: Any) -> LaserTrackerConfig:
    driver_table = {
        "driver": "laser_tracker",
        "name": "at",
        "address": "127.0.0.1",
        "port": port,
        "serial": SERIAL,
    }
    return LaserTrackerConfig.model_validate({**driver_table, "deadline_s": stretched_s(5.0), **changes})


class TestOurDriver:
    """What it sends is what cesapi packs, byte for byte; what cesapi packs is understood."""

    async def test_initialises_sets_up_and_measures_a_point(self) -> None:
        peer = PeerTracker(SERIAL, PLACE_M)
        async with serve_peer(peer) as port, driver_at(port).open() as tracker:
            assert (await tracker.read_condition()).readiness is Readiness.READY
            who = await tracker.identify()
            reading = await tracker.measure_point()
        assert (who.model, who.serial, who.firmware) == ("AT401", str(SERIAL), "emScon 3.8.900")
        assert reading.position_m == PLACE_M
        assert reading.sigma_m == pytest.approx((20e-6, 21e-6, 30e-6))
        assert reading.covariance_m2 == (1e-11, -2e-11, 3e-11)
        assert (reading.air.temperature_c, reading.air.pressure_pa) == (21.5, pytest.approx(99000.0))
        assert reading.air.humidity_percent == 40.0
        kinds = [type(command).__name__ for command in peer.received]
        assert kinds.index("InitializeCT") < kinds.index("StartMeasurementCT")
        assert peer.settings["coordSysType"] == ces.ES_CS_RHR

    async def test_measures_where_there_are_no_covariances(self) -> None:
        peer = PeerTracker(SERIAL, PLACE_M)
        peer.refuses[ces.ES_C_SetStatisticMode] = ces.ES_RS_NotImplemented
        async with serve_peer(peer) as port, driver_at(port).open() as tracker:
            reading = await tracker.measure_point()
        assert reading.position_m == PLACE_M
        assert reading.covariance_m2 == (0.0, 0.0, 0.0)
        assert reading.sigma_m == pytest.approx((20e-6, 21e-6, 30e-6))

    @pytest.mark.parametrize(
        ("instead", "says"),
        [
            (lambda: error_packet(ces.ES_C_Unknown, ces.ES_RS_NoStationaryResult), "NoStationaryResult"),
            (lambda: error_packet(ces.ES_C_StartMeasurement, ces.ES_RS_SensorNotStable), "SensorNotStable"),
            (lambda: status_change(ces.ES_SSC_MeasStatus_NotReady), "MeasurementStatusNotReady"),
        ],
        ids=["unsolicited error", "error of the start", "event"],
    )
    async def test_hears_of_a_broken_beam_and_measures_again(self, instead: Any, says: str) -> None:
        peer = PeerTracker(SERIAL, PLACE_M)
        async with serve_peer(peer) as port, driver_at(port).open() as tracker:
            peer.instead = [instead()]
            with pytest.raises(RefusedError, match=says):
                await tracker.measure_point()
            peer.instead = None
            assert (await tracker.measure_point()).position_m == PLACE_M

    async def test_looks_for_a_lost_reflector(self) -> None:
        peer = PeerTracker(SERIAL, PLACE_M)
        peer.settings["trackerStatus"] = ces.ES_TS_NotReady
        async with serve_peer(peer) as port, driver_at(port, search_distance_m=2.5).open() as tracker:
            with pytest.raises(RefusedError, match="MeasurementStatusNotReady"):
                await tracker.measure_point()
        searched = [command for command in peer.received if isinstance(command, ces.FindReflectorCT)]
        assert [command.dAproxDistance for command in searched] == [2.5]

    async def test_reports_a_new_station_from_the_event(self) -> None:
        peer = PeerTracker(SERIAL, PLACE_M)
        async with serve_peer(peer) as port, driver_at(port).open() as tracker:
            await tracker.measure_point()
            peer.instead = [
                status_change(ces.ES_SSC_StationOrientationParamsChanged),
                status_change(ces.ES_SSC_MeasStatus_NotReady),
            ]
            with pytest.raises(RefusedError):
                await tracker.measure_point()
            with pytest.raises(RefusedError, match="another station"):
                await tracker.measure_point()

    async def test_refuses_another_instrument(self) -> None:
        async with serve_peer(PeerTracker(SERIAL + 1, PLACE_M)) as port:
            with pytest.raises(WrongDeviceError, match=str(SERIAL + 1)):
                async with driver_at(port).open():
                    pass


@pytest.fixture
async def simulated_tracker() -> AsyncIterator[FakeTracker]:
    async with fake_tracker() as device:
        yield device


def _measure_both_ways(client: PeerClient) -> list[Any]:
    """Set up as another maker's program would, and measure with and without covariances."""
    ask = client.command
    ask.Initialize()
    units = ces.SystemUnitsDataT()  # zeros are metre, radian, degree Celsius, millibar
    ask.SetUnits(units)
    ask.SetCoordinateSystemType(ces.ES_CS_RHR)
    ask.SetMeasurementMode(ces.ES_MM_Stationary)
    ask.SetStatisticMode(ces.ES_SM_Standard, ces.ES_SM_Extended)
    with_covariances = ask.StartMeasurement()
    ask.SetStatisticMode(ces.ES_SM_Standard, ces.ES_SM_Standard)
    return [with_covariances, ask.StartMeasurement()]


def _received_packets(client: PeerClient) -> list[Any]:
    ask = client.command
    return [ask.GetSystemStatus(), ask.GetTrackerInfo(), ask.GetEnvironmentParams(), ask.GetUnits(),
            ask.GetSystemSettings(), ask.GetReflector(), ask.GetTransformationParams()]  # fmt: skip


class TestOurFake:
    """cesapi's own client finds a tracker in it."""

    @pytest.fixture
    async def client(self, simulated_tracker: FakeTracker) -> AsyncIterator[PeerClient]:
        client = await asyncio.to_thread(PeerClient, simulated_tracker.server.port)
        yield client
        await asyncio.to_thread(client.close_client)

    async def test_is_initialised_set_up_and_measures_the_truth(
        self, simulated_tracker: FakeTracker, client: PeerClient
    ) -> None:
        await simulated_tracker.inject_fault("not_initialised", {})
        with pytest.raises(Exception, match=f"failed with status {ces.ES_RS_TrackerNotInitialized}"):
            await asyncio.to_thread(client.command.StartMeasurement)
        both = await asyncio.to_thread(_measure_both_ways, client)
        assert [type(found) for found in both] == [ces.SingleMeasResult2T, ces.SingleMeasResultT]
        covariance = np.array(simulated_tracker.true_state()["covariance_m2"])
        for found in both:
            place = np.array([found.dVal1, found.dVal2, found.dVal3])
            expected = np.array([found.dAprioriStd1, found.dAprioriStd2, found.dAprioriStd3])
            assert np.abs((place - believed_position(simulated_tracker)) / expected).max() < 5.0
            assert expected == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-6)
            assert (found.dTemperature, found.dPressure, found.dHumidity) == (20.0, 1013.25, 45.0)
            assert (found.measMode, found.bIsTryMode) == (ces.ES_MM_Stationary, 0)
        mixed = (both[0].dAprioriCovar12, both[0].dAprioriCovar13, both[0].dAprioriCovar23)
        assert mixed == pytest.approx((covariance[0, 1], covariance[0, 2], covariance[1, 2]), rel=1e-6)

    async def test_sends_what_cesapi_can_read(
        self, simulated_tracker: FakeTracker, client: PeerClient
    ) -> None:
        status, info, air, units, flags, reflector, frame = await asyncio.to_thread(_received_packets, client)
        assert (status.trackerProcessorStatus, status.lTrackerSerialNumber) == (
            ces.ES_TPS_Initialized,
            SERIAL,
        )
        assert status.weatherMonitorStatus == ces.ES_WMS_ReadAndCalculateRefractions
        assert info.cTrackerName.decode("utf-16-le").rstrip("\0") == "AT901-MR"
        assert info.lSerialNumber == SERIAL
        assert (air.environmentData.dTemperature, air.environmentData.dPressure) == (20.0, 1013.25)
        assert units.unitsSettings.lenUnitType == ces.ES_LU_Millimeter
        assert units.unitsSettings.angUnitType == ces.ES_AU_Degree
        assert flags.systemSettings.bApplyTransformationParams == 1
        assert (reflector.iInternalReflectorId, frame.transformationData.dScale) == (2, 1.0)

    async def test_reports_a_broken_beam_to_a_client(
        self, simulated_tracker: FakeTracker, client: PeerClient
    ) -> None:
        await simulated_tracker.inject_fault("beam_break", {})
        with pytest.raises(Exception, match=f"failed with status {ces.ES_RS_MeasurementStatusNotReady}"):
            await asyncio.to_thread(client.command.StartMeasurement)
        await asyncio.to_thread(client.command.FindReflector, 3.0)
        assert (await asyncio.to_thread(client.command.StartMeasurement)).packetInfo.status == 0


def _plain_name(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def test_statuses_have_the_numbers_and_names_of_the_header() -> None:
    """Compared where cesapi knows the number: it has the AT40x, not the probe's numbers."""
    theirs = {value: name for name, value in header_table("ES_RS_").items()}
    file = resources.files("cellcal.drivers.laser_tracker") / "statuses.tsv"
    lines = [line for line in file.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    ours = {int(row["code"]): row["text"] for row in csv.DictReader(lines, delimiter="\t")}
    shared = ours.keys() & theirs.keys()
    assert len(shared) > 20
    assert {
        code: theirs[code]
        for code in shared
        if not _plain_name(ours[code]).startswith(_plain_name(theirs[code]))
    } == {}
    assert theirs.keys() >= {1, 2, 3, 39, 10004}


def _misnamed_values(ours: Any, theirs: dict[str, int]) -> list[str]:
    names = {value: _plain_name(name) for name, value in theirs.items()}
    return [one.name for one in ours if _plain_name(one.name) not in names.get(one, "")]


def test_commands_and_events_have_the_numbers_and_names_of_the_header() -> None:
    assert _misnamed_values(TrackerCommand, header_table("ES_C_")) == []
    assert (
        _misnamed_values(StatusChange, {**header_table("ES_SSC_"), **header_table("ES_SCC_")}) == []
    )  # it misspells two
