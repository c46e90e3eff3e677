"""Which nodes of a server are the robot: its motion device, axes, safety states, name plate."""

from collections.abc import Sequence
from dataclasses import dataclass

from asyncua import ua

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError
from cellcal.drivers.opc_ua.axis_units import order_axes
from cellcal.drivers.opc_ua.node_search import FoundChild, NodeSearch
from cellcal.drivers.opc_ua.node_values import check_value_count, read_integer
from cellcal.drivers.opc_ua.server_link import ServerLink

DI = "http://opcfoundation.org/UA/DI/"
ROBOTICS = "http://opcfoundation.org/UA/Robotics/"
_DEVICE_SET = 5001  # Opc.Ua.Di.NodeSet2.xml
_SYSTEM_TYPE, _DEVICE_TYPE, _AXIS_TYPE, _SAFETY_TYPE = 1002, 1004, 16601, 1013  # Opc.Ua.Robotics.NodeSet2.xml
_CONTROLLER_TYPE, _SOFTWARE_TYPE = 1003, 15106
_OTHER_MACHINE = 0  # MotionDeviceCategoryEnumeration: positioners, rails; 1 to 6 are robots
_MAKER = "Ask the maker of the controller for a server that follows OPC 40010-1 in full."
PLATE = ("Manufacturer", "Model", "ProductCode", "SerialNumber")


@dataclass(frozen=True, slots=True)
class RobotSelection:
    """The cell file's selection of the robot's nodes."""

    motion_device: str
    axes: tuple[str, ...]
    axis_count: int


@dataclass(frozen=True, slots=True)
class AxisNodes:
    """One axis: its position, and what says in which unit that is."""

    name: str
    position: ua.NodeId
    unit: ua.NodeId
    motion_profile: ua.NodeId


@dataclass(frozen=True, slots=True)
class ExternalAxisNode:
    """The position of an axis beside the arm, in the server's own unit."""

    name: str
    position: ua.NodeId


@dataclass(frozen=True, slots=True)
class SafetyNodes:
    """One safety state."""

    name: str
    mode: ua.NodeId
    emergency_stop: ua.NodeId
    protective_stop: ua.NodeId


@dataclass(frozen=True, slots=True)
class RobotNodes:
    """Everything that is read; valid in one session, and while the namespaces stay in this order."""

    namespaces: tuple[str, ...]
    session_number: int
    device_name: str
    axes: tuple[AxisNodes, ...]
    external: tuple[
        ExternalAxisNode, ...
    ]  # further axes of the device, and axes of devices that are no robots
    plate: tuple[ua.NodeId, ...]  # in the order of PLATE
    safety: tuple[SafetyNodes, ...]  # empty where the server shows none of them whole
    speed_override: ua.NodeId | None
    software: tuple[ua.NodeId, ...]  # names and revisions of the controller's software, as far as shown


class RobotFinder:
    """Finds the nodes of one robot in one session."""

    def __init__(self, link: ServerLink, namespaces: tuple[str, ...], selection: RobotSelection) -> None:
        self._link, self._namespaces, self._selection = link, namespaces, selection
        self._search = NodeSearch(link, namespaces)
        self._di, self._robotics = self._search.index_of(DI), self._search.index_of(ROBOTICS)

    async def find(self) -> RobotNodes:
        """Return the nodes.

        Raises
        ------
        RefusedError
            The robot cannot be told from others, or something without which it cannot be read is missing.
        """
        session_number = self._link.session_number
        system, device, device_name = await self._choose_device()
        plate = await self._search.follow([(device, [self._di_name(name)]) for name in PLATE])
        for name, node_id in zip(PLATE, plate, strict=True):
            self._require_node(node_id, f"{device_name}/{name}")
        override = await self._search.follow(
            [(device, [self._di_name("ParameterSet"), self._qualified_name("SpeedOverride")])]
        )
        return RobotNodes(
            namespaces=self._namespaces,
            session_number=session_number,
            device_name=device_name,
            axes=(axes := await self._find_axes(device, device_name)),
            external=await self._find_external(system, device, {axis.name for axis in axes}),
            plate=tuple(node_id for node_id in plate if node_id is not None),
            safety=await self._find_safety(system),
            speed_override=override[0],
            software=await self._find_software(system),
        )

    async def _choose_device(self) -> tuple[ua.NodeId, ua.NodeId, str]:
        """Return system and motion device, and the device's name in messages."""
        device_set = ua.NodeId(_DEVICE_SET, self._di)
        found: list[tuple[FoundChild, FoundChild]] = []
        for system in await self._search.children_of_type(device_set, self._type_id(_SYSTEM_TYPE)):
            devices = await self._find_members(system.node_id, "MotionDevices", _DEVICE_TYPE)
            found += [(system, device) for device in devices]
        device_name = self._selection.motion_device
        fitting = [
            pair for pair in found if device_name in ("", pair[1].name, f"{pair[0].name}/{pair[1].name}")
        ]
        if len(fitting) == 1:
            return fitting[0][0].node_id, fitting[0][1].node_id, fitting[0][1].name
        raise self._choice_error([f"{system.name}/{device.name}" for system, device in found])

    async def _find_axes(self, device: ua.NodeId, device_name: str) -> tuple[AxisNodes, ...]:
        children = await self._find_members(device, "Axes", _AXIS_TYPE)
        names = order_axes(
            self._link.device,
            [child.name for child in children],
            self._selection.axes,
            self._selection.axis_count,
        )
        by_name = {child.name: child.node_id for child in children}
        position = [self._di_name("ParameterSet"), self._qualified_name("ActualPosition")]
        units = [*position, ua.QualifiedName("EngineeringUnits", 0)]
        paths: list[tuple[ua.NodeId, Sequence[ua.QualifiedName]]] = []
        for name in names:
            at = by_name[name]
            paths += [(at, position), (at, units), (at, [self._qualified_name("MotionProfile")])]
        ends = await self._search.follow(paths)
        found: list[ua.NodeId] = []
        for (start, path), node_id in zip(paths, ends, strict=True):
            name = next(each for each in names if by_name[each] == start)
            found.append(self._require_node(node_id, f"{device_name}/{name}/{path[-1].Name}"))
        return tuple(AxisNodes(name, *found[3 * k : 3 * k + 3]) for k, name in enumerate(names))

    async def _find_external(
        self, system: ua.NodeId, device: ua.NodeId, of_arm: set[str]
    ) -> tuple[ExternalAxisNode, ...]:
        """Return the axes beside the arm; another robot of the server moves as it likes, and is none of them."""
        found: list[tuple[str, ua.NodeId]] = []
        for one in await self._find_members(system, "MotionDevices", _DEVICE_TYPE):
            if one.node_id != device and not await self._is_no_robot(one.node_id):
                continue
            beside = await self._find_members(one.node_id, "Axes", _AXIS_TYPE)
            found += [
                (f"{one.name}/{axis.name}", axis.node_id)
                for axis in beside
                if one.node_id != device or axis.name not in of_arm
            ]
        path = [self._di_name("ParameterSet"), self._qualified_name("ActualPosition")]
        ends = await self._search.follow([(axis, path) for _, axis in found])
        return tuple(
            ExternalAxisNode(name, end) for (name, _), end in zip(found, ends, strict=True) if end is not None
        )

    async def _is_no_robot(self, device: ua.NodeId) -> bool:
        """Return whether a motion device says of itself that it is another kind of machine."""
        node = (await self._search.follow([(device, [self._qualified_name("MotionDeviceCategory")])]))[0]
        if node is None:
            return False
        values = await self._link.ask(
            lambda session: session.read_attributes([node], ua.AttributeIds.Value), "the category of a device"
        )
        check_value_count(self._link.device, values, 1)
        return read_integer(self._link.device, "MotionDeviceCategory", values[0]) == _OTHER_MACHINE

    async def _find_safety(self, system: ua.NodeId) -> tuple[SafetyNodes, ...]:
        members = ("OperationalMode", "EmergencyStop", "ProtectiveStop")
        found = []
        for state in await self._find_members(system, "SafetyStates", _SAFETY_TYPE):
            paths = [
                (state.node_id, [self._di_name("ParameterSet"), self._qualified_name(name)])
                for name in members
            ]
            mode, emergency, protective = await self._search.follow(paths)
            if mode is None or emergency is None or protective is None:
                return ()
            found.append(SafetyNodes(state.name, mode, emergency, protective))
        return tuple(found)

    async def _find_software(self, system: ua.NodeId) -> tuple[ua.NodeId, ...]:
        kind = ua.NodeId(_SOFTWARE_TYPE, self._di)
        found: list[ua.NodeId] = []
        for controller in await self._find_members(system, "Controllers", _CONTROLLER_TYPE):
            folder = (await self._search.follow([(controller.node_id, [self._qualified_name("Software")])]))[
                0
            ]
            if folder is None:
                continue
            for software in await self._search.children_of_type(folder, kind):
                paths = [(software.node_id, [self._di_name(name)]) for name in ("Model", "SoftwareRevision")]
                found += [node_id for node_id in await self._search.follow(paths) if node_id is not None]
        return tuple(found)

    async def _find_members(self, parent: ua.NodeId, folder: str, kind: int) -> list[FoundChild]:
        """Return the members of a type in a folder; none where the folder is missing."""
        at = (await self._search.follow([(parent, [self._qualified_name(folder)])]))[0]
        return [] if at is None else await self._search.children_of_type(at, self._type_id(kind))

    def _type_id(self, number: int) -> ua.NodeId:
        return ua.NodeId(number, self._robotics)

    def _qualified_name(self, name: str) -> ua.QualifiedName:
        return ua.QualifiedName(name, self._robotics)

    def _di_name(self, name: str) -> ua.QualifiedName:
        return ua.QualifiedName(name, self._di)

    def _require_node(self, node_id: ua.NodeId | None, path: str) -> ua.NodeId:
        if node_id is None:
            raise missing_node_error(self._link.device, path)
        return node_id

    def _choice_error(self, found: list[str]) -> RefusedError:
        names, device_name = ", ".join(found), self._selection.motion_device
        if not found:
            return RefusedError(
                self._link.device, "the OPC UA server shows no motion device of a robot.", remedy=_MAKER
            )
        if device_name:
            message = make_message(
                "the OPC UA server does not show one motion device {wanted}; it shows {names}.",
                wanted=device_name,
                names=names,
            )
        else:
            message = make_message("the OPC UA server shows several motion devices: {names}.", names=names)
        return RefusedError(
            self._link.device, message, remedy="Write the one that is meant in the cell file: motion_device."
        )


def missing_node_error(device: str, path: str) -> RefusedError:
    """Return the error of a node that a robot must have."""
    return RefusedError(
        device, make_message("the OPC UA server does not show {path}.", path=path), remedy=_MAKER
    )
