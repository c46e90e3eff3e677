"""A robot of any maker, read through OPC UA for Robotics (OPC 40010-1). It is never moved and never written to."""

import asyncio
import logging
import struct
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from datetime import datetime

from asyncua import ua

from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import (
    DeviceError,
    DeviceTimeoutError,
    MotionStoppedError,
    RefusedError,
    UnreachableError,
    WrongDeviceError,
)
from cellcal.drivers.interfaces import (
    ActiveFrames,
    Condition,
    Identity,
    JointReading,
    Joints,
    Readiness,
    RobotCapabilities,
    ShownExternalAxis,
)
from cellcal.drivers.opc_ua.axis_units import unit_of_axis
from cellcal.drivers.opc_ua.node_values import (
    check_value_count,
    read_flag,
    read_float,
    read_integer,
    read_structure,
    read_text,
    read_texts,
)
from cellcal.drivers.opc_ua.robot_nodes import (
    PLATE,
    RobotFinder,
    RobotNodes,
    RobotSelection,
    SafetyNodes,
    missing_node_error,
)
from cellcal.drivers.opc_ua.safety_state import SafetyState, condition_of, mode_name
from cellcal.drivers.opc_ua.server_link import ServerLink
from cellcal.drivers.opc_ua.standstill import StandstillWatch
from cellcal.drivers.opc_ua.value_times import ValueTimes, describe_age
from cellcal.drivers.wire.deadline import answer_deadline
from cellcal.drivers.wire.possible_values import check_joints, check_override
from cellcal.drivers.wire.serial_number import check_serial_number

_LOG = logging.getLogger(__name__)
VERIFIED_ON: tuple[str, ...] = ()  # controller software this driver has run on; none yet, see README.md
_NAMESPACE_ARRAY, _SERVER_STATE, _CURRENT_TIME = ua.NodeId(2255), ua.NodeId(2259), ua.NodeId(2258)
_RUNNING = 0  # ServerState
_POLL_S = 0.05
_CLEAR_S = 0.1  # of a deadline, left for what is said at its end
_READ_ONLY = (
    "OPC UA for Robotics shows no such thing: this link only reads joints, stops, mode, override, name plate."
)
_BY_PERSON = (
    "Let a person move the arm at the pendant, and set the motion of the robot in the cell file to observe."
)
_GONE = frozenset((ua.StatusCodes.BadNodeIdUnknown, ua.StatusCodes.BadNodeIdInvalid))

_Choice = Callable[[RobotNodes], Sequence[ua.NodeId]]


@dataclass(frozen=True, slots=True)
class OpcUaOptions:
    """The cell file's options of the robot."""

    serial: str
    motion_device: str
    axes: tuple[str, ...]
    capabilities: RobotCapabilities
    deadline_s: float
    still_s: float


class OpcUaRobot:
    """Robot, KnowsActiveFrames, KnowsMode and KnowsSpeedOverride.

    Positions are polled: each reading is one request for all axes.
    """

    def __init__(self, link: ServerLink, options: OpcUaOptions) -> None:
        self._link, self._options = link, options
        self._selection = RobotSelection(options.motion_device, options.axes, options.capabilities.axes)
        self._nodes: RobotNodes | None = None
        self._standstill = StandstillWatch(options.still_s)
        self._times = ValueTimes()
        self._lock = asyncio.Lock()  # one request at a time: nodes may have to be looked for anew

    @property
    def name(self) -> str:
        return self._link.device

    @property
    def capabilities(self) -> RobotCapabilities:
        return self._options.capabilities

    async def connect(self) -> None:
        """Open a session, find the robot and compare its serial number."""
        found = await self.identify()
        if not found.firmware.startswith(VERIFIED_ON):
            _LOG.warning("%s: not verified on controller software %r", self.name, found.firmware)

    async def close(self) -> None:
        """End the session."""
        await self._link.close()

    async def identify(self) -> Identity:
        async with self._answer_deadline("asking who it is"):
            nodes, values = await self._read(lambda nodes: (*nodes.plate, *nodes.software))
        maker, model, code, serial = (
            read_text(self.name, name, value) for name, value in zip(PLATE, values, strict=False)
        )
        revisions = [read_text(self.name, "Software", value) for value in values[len(nodes.plate) :]]
        return Identity(
            maker, " ".join(filter(None, (model, code))), serial, " ".join(filter(None, revisions))
        )

    async def identity_doubts(self) -> str:
        """Say where the times of the positions do not show that they still come from the arm."""
        async with self._answer_deadline("reading the joints"):
            _, values = await self._read(
                lambda nodes: (_CURRENT_TIME, *(axis.position for axis in nodes.axes))
            )
        clock = None if values[0].Value is None else values[0].Value.Value
        stamps = [value.SourceTimestamp for value in values[1:]]
        return describe_age(stamps, clock if isinstance(clock, datetime) else None)

    async def read_condition(self) -> Condition:
        try:
            async with self._answer_deadline("asking its condition"):
                states = await self._read_safety()
                await self._read_positions()  # an axis whose position is not good is not ready
        except (UnreachableError, DeviceTimeoutError, WrongDeviceError) as error:
            return Condition(Readiness.UNREACHABLE, error.message, error.remedy)
        except DeviceError as error:
            return Condition(Readiness.NOT_READY, error.message, error.remedy)
        return condition_of(states)

    async def read_joints(self) -> JointReading:
        async with self._answer_deadline("reading the joints"):
            reading = await self._read_positions()
            while self._standstill.is_moving() is None:  # the readings so far do not tell
                await asyncio.sleep(_POLL_S)
                reading = await self._read_positions()
        return JointReading(
            reading.joints_rad, bool(self._standstill.is_moving()), reading.taken_at_s, raw=reading.raw
        )

    async def flange_pose(self) -> Pose:
        """Refuse: OPC 40010-1 shows no pose of the flange."""
        raise RefusedError(
            self.name,
            "OPC UA for Robotics does not show where the flange is.",
            remedy="Choose a link of the maker's own for what needs the pose; see deploy/controller_setup.",
        )

    async def active_frames(self) -> ActiveFrames:
        """Return where the axes beside the arm stand; tool, frame and payload are not shown by OPC 40010-1."""
        async with self._answer_deadline("reading the external axes"):
            nodes, values = await self._read(lambda nodes: [axis.position for axis in nodes.external])
        return ActiveFrames(
            external_axes=tuple(
                ShownExternalAxis(axis.name, read_float(self.name, f"{axis.name} ActualPosition", value))
                for axis, value in zip(nodes.external, values, strict=True)
            )
        )

    async def controller_mode(self) -> str:
        async with self._answer_deadline("reading the mode"):
            states = await self._read_safety()
        if not states:
            raise missing_node_error(self.name, "SafetyStates/OperationalMode")
        return mode_name(self.name, states)

    async def speed_override(self) -> float:
        def choose(nodes: RobotNodes) -> Sequence[ua.NodeId]:
            if nodes.speed_override is None:
                raise missing_node_error(self.name, f"{nodes.device_name}/ParameterSet/SpeedOverride")
            return (nodes.speed_override,)

        async with self._answer_deadline("reading the speed override"):
            _, values = await self._read(choose)
        return check_override(self.name, read_float(self.name, "SpeedOverride", values[0]) / 100.0)

    async def move_joints(self, target_rad: Joints, *, speed_rad_s: float) -> None:
        del target_rad, speed_rad_s
        raise RefusedError(self.name, _READ_ONLY, remedy=_BY_PERSON)

    async def stop(self) -> None:
        """Wait until the arm stands; nothing is sent to it.

        Raises
        ------
        MotionStoppedError
            It still moves when the time is over: a person must stop it.
        """
        self._standstill.forget()  # readings from before the call say nothing about a motion that begins
        try:
            async with asyncio.timeout(max(0.0, self._options.deadline_s - _CLEAR_S)):
                await self._wait_for_standstill()
        except TimeoutError:
            raise MotionStoppedError(
                self.name,
                "the arm was not seen standing, and OPC UA for Robotics cannot stop it.",
                remedy="Press the emergency stop if the arm moves.",
            ) from None

    # inside

    async def _wait_for_standstill(self) -> None:
        while (await self.read_joints()).moving:  # noqa: ASYNC110  the server sends no event when an arm stands
            await asyncio.sleep(_POLL_S)

    def _answer_deadline(self, doing: str) -> AbstractAsyncContextManager[None]:
        return answer_deadline(self.name, self._options.deadline_s, doing, is_half=self._link.is_half)

    async def _read_positions(self) -> JointReading:
        """Read all axes with their units in one request, and note them for the judgement of standstill."""
        nodes, values = await self._read(
            lambda nodes: [
                each for axis in nodes.axes for each in (axis.position, axis.unit, axis.motion_profile)
            ]
        )
        stated: list[float] = []
        joints: list[float] = []
        for k, axis in enumerate(nodes.axes):
            position, unit, profile = values[3 * k : 3 * k + 3]
            stated.append(read_float(self.name, f"{axis.name} ActualPosition", position))
            joints.append(stated[-1] * self._scale_of(axis.name, unit, profile))
        check_joints(self.name, tuple(joints))
        now_s = time.monotonic()
        for k, axis in enumerate(nodes.axes):
            self._times.take_value(self.name, axis.name, stated[k], values[3 * k].SourceTimestamp, now_s)
        self._standstill.add_reading(now_s, joints)
        raw = struct.pack(f"<{len(stated)}d", *stated).hex()
        return JointReading(tuple(joints), moving=True, taken_at_s=now_s, raw=raw)

    def _scale_of(self, axis: str, unit: ua.DataValue, profile: ua.DataValue) -> float:
        """Return radians, or metres, per unit of an axis."""
        stated = read_structure(self.name, f"{axis} EngineeringUnits", unit)
        motion_profile = read_integer(self.name, f"{axis} MotionProfile", profile)
        return unit_of_axis(self.name, axis, stated, motion_profile).to_si

    async def _read_safety(self) -> list[SafetyState]:
        def choose(nodes: RobotNodes) -> Sequence[ua.NodeId]:
            return [each for state in nodes.safety for each in _nodes_of_state(state)]

        nodes, values = await self._read(choose)
        states = []
        for index, state in enumerate(nodes.safety):
            mode, emergency, protective = values[3 * index : 3 * index + 3]
            states.append(
                SafetyState(
                    read_integer(self.name, f"{state.name} OperationalMode", mode),
                    read_flag(self.name, f"{state.name} EmergencyStop", emergency),
                    read_flag(self.name, f"{state.name} ProtectiveStop", protective),
                )
            )
        return states

    async def _read(self, choose: _Choice) -> tuple[RobotNodes, list[ua.DataValue]]:
        """Read nodes of the robot, looked for anew where the server came back or has reordered its namespaces."""
        async with self._lock:
            nodes = await self._current_nodes()
            values = await self._read_with_state(choose(nodes))
            if values is None or self._are_outdated(nodes, values):
                nodes = await self._find_nodes()
                values = await self._read_with_state(choose(nodes))
                if values is None or self._are_outdated(nodes, values):
                    raise UnreachableError(
                        self.name,
                        "the OPC UA server changes its nodes while they are read.",
                        remedy="Wait until the controller has started, then try again.",
                    )
        self._refuse_stopped_server(values[0])
        return nodes, values[2:]

    async def _current_nodes(self) -> RobotNodes:
        await self._link.connect()
        if self._nodes is None or self._nodes.session_number != self._link.session_number:
            return await self._find_nodes()
        return self._nodes

    async def _find_nodes(self) -> RobotNodes:
        """Find the robot in this session, and refuse another one than the cell file's."""
        self._nodes = None
        self._standstill.forget()
        self._times.forget()
        array = await self._link.ask(
            lambda session: session.read_attributes([_NAMESPACE_ARRAY], ua.AttributeIds.Value),
            "its namespaces",
        )
        check_value_count(self.name, array, 1)
        namespaces = read_texts(self.name, "NamespaceArray", array[0])
        nodes = await RobotFinder(self._link, namespaces, self._selection).find()
        plate = await self._link.ask(
            lambda session: session.read_attributes(list(nodes.plate), ua.AttributeIds.Value),
            "its name plate",
        )
        check_value_count(self.name, plate, len(PLATE))
        check_serial_number(
            self.name,
            read_text(self.name, "SerialNumber", plate[PLATE.index("SerialNumber")]),
            self._options.serial,
        )
        self._nodes = nodes
        return nodes

    async def _read_with_state(self, chosen: Sequence[ua.NodeId]) -> list[ua.DataValue] | None:
        """Read the server's state, its namespaces and the chosen nodes in one request; None after a lost session."""
        session_number = self._link.session_number
        nodes = [_SERVER_STATE, _NAMESPACE_ARRAY, *chosen]
        values = await self._link.ask(
            lambda session: session.read_attributes(nodes, ua.AttributeIds.Value), "values of the robot"
        )
        check_value_count(self.name, values, len(nodes))
        return values if self._link.session_number == session_number else None

    def _are_outdated(self, nodes: RobotNodes, values: Sequence[ua.DataValue]) -> bool:
        if read_texts(self.name, "NamespaceArray", values[1]) != nodes.namespaces:
            return True
        return any(value.StatusCode is not None and value.StatusCode.value in _GONE for value in values)

    def _refuse_stopped_server(self, value: ua.DataValue) -> None:
        state = read_integer(self.name, "ServerState", value)
        if state != _RUNNING:
            raise RefusedError(
                self.name,
                make_message("the OPC UA server is not running: it shows the state {state}.", state=state),
                remedy="Look at the controller, and start its OPC UA server again if it stays so.",
            )


def _nodes_of_state(state: SafetyNodes) -> tuple[ua.NodeId, ua.NodeId, ua.NodeId]:
    return state.mode, state.emergency_stop, state.protective_stop
