"""Nodes and references of an OPC UA server, and the three services that look at them.

Imitates
    The address space of an OPC UA server: View services (Browse, BrowseNext, TranslateBrowsePathsToNodeIds) and Read.
Source
    OPC 10000-3 (address space), OPC 10000-4 (services), as published.
Modelled
    Objects, variables, types with their subtypes, references in both directions, continuation points.
Not modelled
    Views, methods, writing, events, ranges within arrays.
"""

import itertools
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from datetime import UTC, datetime

from asyncua import ua

ORGANIZES, HAS_COMPONENT, HAS_PROPERTY = 35, 47, 46
HAS_SUBTYPE, HAS_TYPE_DEFINITION = 45, 40
_PARENTS = {35: 33, 47: 44, 46: 44, 44: 34, 45: 34, 34: 33, 33: 31, 40: 32, 32: 31}  # of reference types

ValueSource = Callable[[], ua.DataValue]


def as_data_value(value: ua.Variant, status: int = ua.StatusCodes.Good) -> ua.DataValue:
    """Return a value as a server hands it out, with the time of now."""
    now = datetime.now(UTC)
    return ua.DataValue(value, ua.StatusCode(ua.UInt32(status)), SourceTimestamp=now, ServerTimestamp=now)


@dataclass
class SpaceNode:
    """One node; references are (type of the reference, forward, target)."""

    node_id: ua.NodeId
    node_class: ua.NodeClass
    browse_name: ua.QualifiedName
    type_definition: ua.NodeId = field(default_factory=ua.NodeId)
    read_value: ValueSource | None = None
    data_type: ua.NodeId = field(default_factory=ua.NodeId)
    references: list[tuple[int, bool, ua.NodeId]] = field(default_factory=list)


class NodeTable:
    """All nodes of one server."""

    def __init__(self, references_per_answer: int = 0) -> None:
        self.nodes: dict[ua.NodeId, SpaceNode] = {}
        self._per_answer = references_per_answer  # 0: as many as there are
        self._continued: dict[bytes, tuple[list[ua.ReferenceDescription], int]] = {}
        self._points = itertools.count(1)

    def add_node(
        self, node: SpaceNode, parent: ua.NodeId | None = None, how: int = HAS_COMPONENT
    ) -> SpaceNode:
        """Add a node below a parent, and its reference to its type."""
        self.nodes[node.node_id] = node
        if parent is not None:
            self.connect(parent, how, node.node_id)
        if not node.type_definition.is_null():
            node.references.append((HAS_TYPE_DEFINITION, True, node.type_definition))
        return node

    def connect(self, source: ua.NodeId, how: int, target: ua.NodeId) -> None:
        """Add a reference, and its inverse."""
        self.nodes[source].references.append((how, True, target))
        self.nodes[target].references.append((how, False, source))

    def browse(self, description: ua.BrowseDescription, most: int) -> ua.BrowseResult:
        """Return the references of a node that a client asks for, the first ``most`` of them."""
        node = self.nodes.get(description.NodeId)
        if node is None:
            return ua.BrowseResult(ua.StatusCode(ua.UInt32(ua.StatusCodes.BadNodeIdUnknown)))
        found = [
            self._describe_reference(how, forward, target)
            for how, forward, target in node.references
            if _is_asked_for(how, description.ReferenceTypeId, subtypes=description.IncludeSubtypes)
            and description.BrowseDirection
            in (
                ua.BrowseDirection.Both,
                ua.BrowseDirection.Forward if forward else ua.BrowseDirection.Inverse,
            )
            and (not description.NodeClassMask or self._class_of(target) & description.NodeClassMask)
        ]
        limits = [limit for limit in (most, self._per_answer) if limit]
        return self._first_part(found, min(limits) if limits else len(found))

    def browse_next(self, point: bytes, *, release: bool) -> ua.BrowseResult:
        """Return what a browse left off."""
        rest = self._continued.pop(point, None)
        if rest is None:
            return ua.BrowseResult(ua.StatusCode(ua.UInt32(ua.StatusCodes.BadContinuationPointInvalid)))
        return ua.BrowseResult() if release else self._first_part(*rest)

    def translate(self, path: ua.BrowsePath) -> ua.BrowsePathResult:
        """Return the nodes at the end of a path of browse names."""
        if path.StartingNode not in self.nodes:
            return ua.BrowsePathResult(ua.StatusCode(ua.UInt32(ua.StatusCodes.BadNodeIdUnknown)))
        at = [path.StartingNode]
        for element in path.RelativePath.Elements:
            at = [target for node_id in at for target in self._find_targets(node_id, element)]
        if not at:
            return ua.BrowsePathResult(ua.StatusCode(ua.UInt32(ua.StatusCodes.BadNoMatch)))
        targets = [ua.BrowsePathTarget(_expanded_id(node_id), ua.UInt32(0xFFFFFFFF)) for node_id in at]
        return ua.BrowsePathResult(ua.StatusCode(), targets)

    def read(self, node_id: ua.NodeId, attribute: int) -> ua.DataValue:
        """Return an attribute of a node."""
        node = self.nodes.get(node_id)
        if node is None:
            return _bad_value(ua.StatusCodes.BadNodeIdUnknown)
        if attribute == ua.AttributeIds.Value:
            return (
                _bad_value(ua.StatusCodes.BadAttributeIdInvalid)
                if node.read_value is None
                else node.read_value()
            )
        values: dict[int, ua.Variant] = {
            ua.AttributeIds.NodeId: ua.Variant(node.node_id, ua.VariantType.NodeId),
            ua.AttributeIds.NodeClass: ua.Variant(int(node.node_class), ua.VariantType.Int32),
            ua.AttributeIds.BrowseName: ua.Variant(node.browse_name, ua.VariantType.QualifiedName),
            ua.AttributeIds.DisplayName: ua.Variant(
                _text(node.browse_name.Name), ua.VariantType.LocalizedText
            ),
        }
        if node.read_value is not None:
            values |= {
                ua.AttributeIds.DataType: ua.Variant(node.data_type, ua.VariantType.NodeId),
                ua.AttributeIds.ValueRank: ua.Variant(-1, ua.VariantType.Int32),
                ua.AttributeIds.AccessLevel: ua.Variant(1, ua.VariantType.Byte),
                ua.AttributeIds.UserAccessLevel: ua.Variant(1, ua.VariantType.Byte),
            }
        if attribute not in values:
            return _bad_value(ua.StatusCodes.BadAttributeIdInvalid)
        return as_data_value(values[attribute])

    def _first_part(self, references: list[ua.ReferenceDescription], most: int) -> ua.BrowseResult:
        first, rest = references[:most], references[most:]
        result = ua.BrowseResult(ua.StatusCode(), References=first)
        if rest:
            point = f"rest {next(self._points)}".encode()
            self._continued[point] = (rest, most)
            result.ContinuationPoint = point
        return result

    def _class_of(self, node_id: ua.NodeId) -> int:
        node = self.nodes.get(node_id)
        return int(node.node_class) if node is not None else 0

    def _describe_reference(self, how: int, forward: bool, target: ua.NodeId) -> ua.ReferenceDescription:
        node = self.nodes.get(target)
        description = ua.ReferenceDescription(ua.NodeId(how), forward, _expanded_id(target))
        if node is not None:
            description.BrowseName = node.browse_name
            description.DisplayName = _text(node.browse_name.Name)
            description.NodeClass = node.node_class
            description.TypeDefinition = _expanded_id(node.type_definition)
        return description

    def _find_targets(self, node_id: ua.NodeId, element: ua.RelativePathElement) -> Iterable[ua.NodeId]:
        for how, forward, target in self.nodes[node_id].references:
            node = self.nodes.get(target)
            if node is None or forward is element.IsInverse or node.browse_name != element.TargetName:
                continue
            if _is_asked_for(how, element.ReferenceTypeId, subtypes=element.IncludeSubtypes):
                yield target


def _is_asked_for(how: int, wanted: ua.NodeId, *, subtypes: bool) -> bool:
    if wanted.is_null():
        return True
    number: int | None = how
    while number is not None:
        if wanted.NamespaceIndex == 0 and number == wanted.Identifier:
            return True
        number = _PARENTS.get(number) if subtypes else None
    return False


def _expanded_id(node_id: ua.NodeId) -> ua.ExpandedNodeId:
    return ua.ExpandedNodeId(node_id.Identifier, node_id.NamespaceIndex, node_id.NodeIdType)


def _text(words: str) -> ua.LocalizedText:
    return ua.LocalizedText(words)


def _bad_value(status: int) -> ua.DataValue:
    return as_data_value(ua.Variant(), status)
