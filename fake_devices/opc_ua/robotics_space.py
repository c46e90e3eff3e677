"""The nodes that show a robot, as OPC 40010-1 arranges them.

Imitates
    The address space of a server with the companion specifications Devices (DI) and Robotics.
Source
    Opc.Ua.Di.NodeSet2.xml 1.04 and Opc.Ua.Robotics.NodeSet2.xml 1.02, as published: names, type ids, references;
    UNECE recommendation 20 for units.
Modelled
    Objects/DeviceSet with a MotionDeviceSystem: MotionDevices with name plate, Axes (MotionProfile, ActualPosition
    with EngineeringUnits) and SpeedOverride; SafetyStates; Controllers with Software. Mandatory members that the
    layout names as absent are left out; names in the order of a hash table, as servers have them.
Not modelled
    PowerTrains, TaskControls, loads, ActualSpeed; most nodes of the base specification.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

from asyncua import ua

from cellcal.fake_devices.opc_ua.controller import NamePlate, RobotController
from cellcal.fake_devices.opc_ua.node_table import (
    HAS_COMPONENT,
    HAS_PROPERTY,
    HAS_SUBTYPE,
    ORGANIZES,
    NodeTable,
    SpaceNode,
    as_data_value,
)

BASE = "http://opcfoundation.org/UA/"
DI = "http://opcfoundation.org/UA/DI/"
ROBOTICS = "http://opcfoundation.org/UA/Robotics/"
VENDOR = "urn:example-robotics:cell"
USUAL_ORDER = (BASE, "urn:example-robotics:server", DI, "http://opcfoundation.org/UA/IA/", ROBOTICS, VENDOR)

_SYSTEM_TYPE, _DEVICE_TYPE, _AXIS_TYPE = 1002, 1004, 16601
_CONTROLLER_TYPE, _SAFETY_TYPE, _SOFTWARE_TYPE = 1003, 1013, 15106
_DEVICE_SET = 5001
_FOLDER, _BASE_OBJECT, _VARIABLE, _PROPERTY, _ANALOG = 61, 58, 63, 68, 17497
_UNITS = {"deg": (17476, "deg"), "rad": (4405297, "rad"), "mm": (5066068, "mm"), "inch": (4804168, "in")}
_ROTARY, _LINEAR = 1, 3
_OTHER_MACHINE, _ARTICULATED = 0, 1  # MotionDeviceCategory

ValueFault = Callable[[str, ua.DataValue], ua.DataValue]


@dataclass(frozen=True)
class RobotLayout:
    """The form in which this server shows its robots; a restart may change it."""

    namespaces: tuple[str, ...] = USUAL_ORDER
    devices: tuple[str, ...] = ("Arm",)
    axis_names: tuple[str, ...] = tuple(f"Axis_{number}" for number in range(1, 7))
    units: tuple[str, ...] = ("deg",) * 6
    absent: frozenset[str] = field(default_factory=frozenset)  # paths below a device or system, "Axes/Axis_3"
    has_vendor_types: bool = True
    references_per_answer: int = 3
    machines: frozenset[str] = frozenset()  # devices that are no robots: rails, positioners


class SpaceBuilder:
    """Builds the nodes once; values are read when a client asks."""

    def __init__(self, controller: RobotController, layout: RobotLayout, corrupt: ValueFault) -> None:
        self._controller, self._layout, self._corrupt = controller, layout, corrupt
        self._started_at = datetime.now(UTC)
        self.table = NodeTable(layout.references_per_answer)

    def build(self) -> NodeTable:
        """Return the whole address space."""
        self._add_base_nodes()
        self._add_types()
        self._add_system()
        return self.table

    def _namespace_index(self, uri: str) -> int:
        return self._layout.namespaces.index(uri)

    def _vendor_id(self, path: str) -> ua.NodeId:
        return ua.NodeId(path, self._namespace_index(VENDOR))

    def _qualified_name(self, uri: str, name: str) -> ua.QualifiedName:
        return ua.QualifiedName(name, self._namespace_index(uri))

    def _robotics_id(self, number: int) -> ua.NodeId:
        return ua.NodeId(number, self._namespace_index(ROBOTICS))

    # nodes of the base specification

    def _add_base_nodes(self) -> None:
        objects, server = ua.NodeId(85), ua.NodeId(2253)
        for number, name, parent in (
            (84, "Root", None),
            (85, "Objects", 84),
            (86, "Types", 84),
            (87, "Views", 84),
        ):
            self._add_object(ua.NodeId(number), self._qualified_name(BASE, name), ua.NodeId(_FOLDER),
                         None if parent is None else ua.NodeId(parent), ORGANIZES)  # fmt: skip
        self._add_object(server, self._qualified_name(BASE, "Server"), ua.NodeId(2004), objects)
        texts = list(self._layout.namespaces)
        self._add_base_variable(
            2254, "ServerArray", server, lambda: ua.Variant(texts[1:2], ua.VariantType.String)
        )
        self._add_base_variable(
            2255, "NamespaceArray", server, lambda: ua.Variant(texts, ua.VariantType.String)
        )
        status = ua.NodeId(2256)
        self._add_object(status, self._qualified_name(BASE, "ServerStatus"), ua.NodeId(2138), server)
        started = self._started_at
        self._add_base_variable(
            2257, "StartTime", status, lambda: ua.Variant(started, ua.VariantType.DateTime)
        )
        self._add_base_variable(
            2258, "CurrentTime", status, lambda: ua.Variant(datetime.now(UTC), ua.VariantType.DateTime)
        )
        self._add_base_variable(2259, "State", status, lambda: ua.Variant(0, ua.VariantType.Int32))
        self._add_object(
            ua.NodeId(_DEVICE_SET, self._namespace_index(DI)),
            self._qualified_name(DI, "DeviceSet"),
            ua.NodeId(58),
            objects,
            ORGANIZES,
        )

    def _add_base_variable(
        self, number: int, name: str, parent: ua.NodeId, value: Callable[[], ua.Variant]
    ) -> None:
        self.table.add_node(
            SpaceNode(
                ua.NodeId(number), ua.NodeClass.Variable, self._qualified_name(BASE, name), ua.NodeId(_VARIABLE),
                lambda: self._corrupt(name, as_data_value(value())), ua.NodeId(24),
            ),
            parent, HAS_COMPONENT,
        )  # fmt: skip

    def _add_types(self) -> None:
        for number, name in ((_BASE_OBJECT, "BaseObjectType"), (_FOLDER, "FolderType")):
            self._add_type(
                ua.NodeId(number), self._qualified_name(BASE, name), None if number == 58 else ua.NodeId(58)
            )
        for number, name in (
            (_SYSTEM_TYPE, "MotionDeviceSystemType"),
            (_DEVICE_TYPE, "MotionDeviceType"),
            (_AXIS_TYPE, "AxisType"),
            (_CONTROLLER_TYPE, "ControllerType"),
            (_SAFETY_TYPE, "SafetyStateType"),
        ):
            self._add_type(
                self._robotics_id(number), self._qualified_name(ROBOTICS, name), ua.NodeId(_BASE_OBJECT)
            )
        software = ua.NodeId(_SOFTWARE_TYPE, self._namespace_index(DI))
        self._add_type(software, self._qualified_name(DI, "SoftwareType"), ua.NodeId(_BASE_OBJECT))
        self._add_type(
            self._vendor_id("ArmType"),
            self._qualified_name(VENDOR, "ArmType"),
            self._robotics_id(_DEVICE_TYPE),
        )
        self._add_type(
            self._vendor_id("JointType"),
            self._qualified_name(VENDOR, "JointType"),
            self._robotics_id(_AXIS_TYPE),
        )

    def _add_type(self, node_id: ua.NodeId, name: ua.QualifiedName, parent: ua.NodeId | None) -> None:
        self.table.add_node(SpaceNode(node_id, ua.NodeClass.ObjectType, name), parent, HAS_SUBTYPE)

    # the robot

    def _add_system(self) -> None:
        device_set = ua.NodeId(_DEVICE_SET, self._namespace_index(DI))
        system = self._vendor_id("System")
        self._add_object(
            system, self._qualified_name(VENDOR, "System"), self._robotics_id(_SYSTEM_TYPE), device_set
        )
        self._add_object(
            self._vendor_id("Pump"), self._qualified_name(VENDOR, "Pump"), ua.NodeId(_BASE_OBJECT), device_set
        )
        self._add_folder("System", "MotionDevices")
        self._add_folder("System", "Controllers")
        self._add_folder("System", "SafetyStates")
        for number, name in enumerate(self._layout.devices):
            self._add_device(f"System/MotionDevices/{name}", name, is_first=number == 0)
        self._add_controller("System/Controllers/Cabinet")
        self._add_safety("System/SafetyStates/Safety")

    def _add_device(self, path: str, name: str, *, is_first: bool) -> None:
        kind = (
            self._vendor_id("ArmType") if self._layout.has_vendor_types else self._robotics_id(_DEVICE_TYPE)
        )
        if not self._add_object_below("System/MotionDevices", VENDOR, name, kind):
            return
        plate = self._controller.plate
        serial = plate.serial if is_first else f"{plate.serial}-{name}"
        self._add_plate(path, NamePlate(plate.manufacturer, plate.model, plate.product_code, serial))
        category = _OTHER_MACHINE if name in self._layout.machines else _ARTICULATED
        self._add_property(
            path, ROBOTICS, "MotionDeviceCategory", lambda: ua.Variant(category, ua.VariantType.Int32)
        )
        self._add_folder(path, "Axes")
        self._add_object_below(path, DI, "ParameterSet", ua.NodeId(_BASE_OBJECT))
        self._add_variable(f"{path}/ParameterSet", ROBOTICS, "SpeedOverride", _VARIABLE, self._read_override)
        numbers = list(range(len(self._layout.axis_names)))
        for axis in numbers[1::2] + numbers[0::2]:
            self._add_axis(f"{path}/Axes", axis, is_first=is_first)

    def _read_override(self) -> ua.Variant:
        return ua.Variant(self._controller.override_percent, ua.VariantType.Double)

    def _add_plate(self, path: str, plate: NamePlate) -> None:
        self._add_constant(path, "Manufacturer", _localized_text(plate.manufacturer))
        self._add_constant(path, "Model", _localized_text(plate.model))
        self._add_constant(path, "ProductCode", ua.Variant(plate.product_code, ua.VariantType.String))
        self._add_constant(path, "SerialNumber", ua.Variant(plate.serial, ua.VariantType.String))

    def _add_axis(self, axes: str, axis: int, *, is_first: bool) -> None:
        name, unit = self._layout.axis_names[axis], self._layout.units[axis]
        kind = (
            self._vendor_id("JointType") if self._layout.has_vendor_types else self._robotics_id(_AXIS_TYPE)
        )
        if not self._add_object_below(axes, VENDOR, name, kind):
            return
        path = f"{axes}/{name}"
        profile = _LINEAR if unit == "mm" else _ROTARY
        self._add_property(path, ROBOTICS, "MotionProfile", lambda: ua.Variant(profile, ua.VariantType.Int32))
        self._add_object_below(path, DI, "ParameterSet", ua.NodeId(_BASE_OBJECT))

        def read_position() -> ua.Variant:
            is_of_arm = is_first and axis < len(self._controller.arm.joints_rad)
            value = self._controller.shown_joint(axis, unit) if is_of_arm else 0.0
            return ua.Variant(value, ua.VariantType.Double)

        self._add_variable(f"{path}/ParameterSet", ROBOTICS, "ActualPosition", _ANALOG, read_position)
        number, shown = _UNITS[unit]
        units = ua.EUInformation(
            "http://www.opcfoundation.org/UA/units/un/cefact",
            number,
            ua.LocalizedText(shown),
            ua.LocalizedText(unit),
        )
        self._add_property(
            f"{path}/ParameterSet/ActualPosition", BASE, "EngineeringUnits",
            lambda: ua.Variant(units, ua.VariantType.ExtensionObject),
        )  # fmt: skip

    def _add_controller(self, path: str) -> None:
        kind = self._robotics_id(_CONTROLLER_TYPE)
        self._add_object_below("System/Controllers", VENDOR, "Cabinet", kind)
        self._add_folder(path, "Software")
        self._add_object_below(
            f"{path}/Software", VENDOR, "System", ua.NodeId(_SOFTWARE_TYPE, self._namespace_index(DI))
        )
        self._add_constant(f"{path}/Software/System", "Model", _localized_text("MotionWare"))
        self._add_constant(
            f"{path}/Software/System", "SoftwareRevision", ua.Variant("2.7.1", ua.VariantType.String)
        )

    def _add_safety(self, path: str) -> None:
        if not self._add_object_below(
            "System/SafetyStates", VENDOR, "Safety", self._robotics_id(_SAFETY_TYPE)
        ):
            return
        self._add_object_below(path, DI, "ParameterSet", ua.NodeId(_BASE_OBJECT))
        controller = self._controller
        for name, read in (
            ("OperationalMode", lambda: ua.Variant(controller.mode, ua.VariantType.Int32)),
            ("EmergencyStop", lambda: ua.Variant(controller.emergency_stop, ua.VariantType.Boolean)),
            ("ProtectiveStop", lambda: ua.Variant(controller.protective_stop, ua.VariantType.Boolean)),
        ):
            self._add_variable(f"{path}/ParameterSet", ROBOTICS, name, _VARIABLE, read)

    # one node

    def _is_absent(self, path: str) -> bool:
        short = "/" + path
        return any(short.endswith("/" + name) for name in self._layout.absent)

    def _add_object(
        self, node_id: ua.NodeId, name: ua.QualifiedName, kind: ua.NodeId, parent: ua.NodeId | None,
        how: int = HAS_COMPONENT,
    ) -> None:  # fmt: skip
        self.table.add_node(SpaceNode(node_id, ua.NodeClass.Object, name, kind), parent, how)

    def _add_object_below(self, parent: str, uri: str, name: str, kind: ua.NodeId) -> bool:
        if self._is_absent(f"{parent}/{name}") or self._vendor_id(parent) not in self.table.nodes:
            return False
        self._add_object(
            self._vendor_id(f"{parent}/{name}"),
            self._qualified_name(uri, name),
            kind,
            self._vendor_id(parent),
        )
        return True

    def _add_folder(self, parent: str, name: str) -> None:
        self._add_object_below(parent, ROBOTICS, name, ua.NodeId(_FOLDER))

    def _add_constant(self, parent: str, name: str, value: Any) -> None:
        self._add_property(parent, DI, name, lambda: value)

    def _add_property(self, parent: str, uri: str, name: str, value: Callable[[], ua.Variant]) -> None:
        self._add_variable(parent, uri, name, _PROPERTY, value, HAS_PROPERTY)

    def _add_variable(
        self, parent: str, uri: str, name: str, kind: int, value: Callable[[], ua.Variant],
        how: int = HAS_COMPONENT,
    ) -> None:  # fmt: skip
        path = f"{parent}/{name}"
        if self._is_absent(path) or self._vendor_id(parent) not in self.table.nodes:
            return
        self.table.add_node(
            SpaceNode(
                self._vendor_id(path), ua.NodeClass.Variable, self._qualified_name(uri, name), ua.NodeId(kind),
                lambda: self._corrupt(path, as_data_value(value())), ua.NodeId(24),
            ),
            self._vendor_id(parent), how,
        )  # fmt: skip


def _localized_text(text: str) -> Any:
    return ua.Variant(ua.LocalizedText(text, "en"), ua.VariantType.LocalizedText)
