"""Browsing, paths and types: what looking for nodes needs, in few requests. No index of a namespace is fixed."""

from collections.abc import Sequence
from dataclasses import dataclass

from asyncua import ua

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError, WireProtocolError
from cellcal.drivers.opc_ua.server_link import ServerLink

_HIERARCHICAL, _HAS_SUBTYPE = 33, 45
_ALL_FIELDS = 63
_WHOLE_PATH = 0xFFFFFFFF
_MOST_ANSWERS = 1000  # BrowseNext requests of one browse, and steps up a tree of types
_REPORT = "Report this with the name and the version of the server."


@dataclass(frozen=True, slots=True)
class FoundChild:
    """A node below another one."""

    name: str
    node_id: ua.NodeId
    type_id: ua.NodeId


class NodeSearch:
    """Looks for nodes of one session; ``namespaces`` are the server's, in its order."""

    def __init__(self, link: ServerLink, namespaces: Sequence[str]) -> None:
        self._link, self._namespaces = link, namespaces

    def index_of(self, uri: str) -> int:
        """Return the index of a namespace in this session.

        Raises
        ------
        RefusedError
            The server does not have it, or has it twice.
        """
        count = list(self._namespaces).count(uri)
        if count == 1:
            return list(self._namespaces).index(uri)
        raise RefusedError(
            self._link.device,
            make_message(
                "the OPC UA server has the namespace {uri} {count} times; it has {uris}.",
                uri=uri,
                count=count,
                uris=", ".join(self._namespaces),
            ),
            remedy="Switch on OPC UA for Robotics (OPC 40010-1) on the controller; it may be an option to buy.",
        )

    async def children_of(self, node_id: ua.NodeId) -> list[FoundChild]:
        """Return the objects and variables below a node, without placeholders that a server took over from a type."""
        description = ua.BrowseDescription(
            node_id,
            ua.BrowseDirection.Forward,
            ua.NodeId(_HIERARCHICAL),
            True,
            ua.UInt32(0),
            ua.UInt32(_ALL_FIELDS),
        )
        references = (await self._browse_nodes([description]))[0]
        found = [
            FoundChild(
                reference.BrowseName.Name or "",
                self._to_local(reference.NodeId),
                self._to_local(reference.TypeDefinition),
            )
            for reference in references
        ]
        return [child for child in found if not (child.name.startswith("<") and child.name.endswith(">"))]

    async def children_of_type(self, node_id: ua.NodeId, wanted: ua.NodeId) -> list[FoundChild]:
        """Return the children whose type is this one or derived from it."""
        children = await self.children_of(node_id)
        kinds = {child.type_id for child in children if not child.type_id.is_null()}
        fitting = {kind for kind in kinds if await self._is_derived(kind, wanted)}
        return [child for child in children if child.type_id in fitting]

    async def follow(
        self, paths: Sequence[tuple[ua.NodeId, Sequence[ua.QualifiedName]]]
    ) -> list[ua.NodeId | None]:
        """Return the node at the end of each path of browse names; None where there is none."""
        if not paths:
            return []
        hierarchical = ua.NodeId(_HIERARCHICAL)
        questions = [
            ua.BrowsePath(
                start,
                ua.RelativePath([ua.RelativePathElement(hierarchical, False, True, name) for name in names]),
            )
            for start, names in paths
        ]
        results = await self._link.ask(
            lambda session: session.translate_browsepaths_to_nodeids(questions), "paths of nodes"
        )
        self._check_count(results, len(questions))
        return [
            self._end_of(result, names[-1].Name or "")
            for result, (_, names) in zip(results, paths, strict=True)
        ]

    async def _is_derived(self, kind: ua.NodeId, wanted: ua.NodeId) -> bool:
        visited = {kind}
        at = kind
        while at != wanted:
            description = ua.BrowseDescription(
                at,
                ua.BrowseDirection.Inverse,
                ua.NodeId(_HAS_SUBTYPE),
                True,
                ua.UInt32(0),
                ua.UInt32(_ALL_FIELDS),
            )
            above = (await self._browse_nodes([description]))[0]
            if not above:
                return False
            at = self._to_local(above[0].NodeId)
            if at in visited:
                return False
            visited.add(at)
        return True

    async def _browse_nodes(
        self, descriptions: list[ua.BrowseDescription]
    ) -> list[list[ua.ReferenceDescription]]:
        parameters = ua.BrowseParameters(NodesToBrowse=descriptions)
        results = await self._link.ask(
            lambda session: session.browse(parameters), "the nodes below another one"
        )
        self._check_count(results, len(descriptions))
        return [await self._complete_result(result) for result in results]

    async def _complete_result(self, result: ua.BrowseResult) -> list[ua.ReferenceDescription]:
        """Return what a browse found, with all that the server left off at first."""
        self._check_status(result.StatusCode)
        references = list(result.References or [])
        answers = 0
        while result.ContinuationPoint:
            parameters = ua.BrowseNextParameters(False, [result.ContinuationPoint])
            more = await self._link.ask(
                lambda session, parameters=parameters: session.browse_next(parameters),  # type: ignore[misc]
                "the nodes below another one",
            )
            self._check_count(more, 1)
            result, answers = more[0], answers + 1
            self._check_status(result.StatusCode)
            references += result.References or []
            if answers > _MOST_ANSWERS:
                raise self._nonsense_error("a list of nodes has no end")
        return references

    def _end_of(self, result: ua.BrowsePathResult, name: str) -> ua.NodeId | None:
        if result.StatusCode.value == ua.StatusCodes.BadNoMatch:
            return None
        self._check_status(result.StatusCode)
        found = {
            self._to_local(target.TargetId)
            for target in result.Targets or []
            if target.RemainingPathIndex == _WHOLE_PATH
        }
        if len(found) > 1:
            raise self._nonsense_error(make_message("it has several nodes {name} in one place", name=name))
        return found.pop() if found else None

    def _to_local(self, node_id: ua.ExpandedNodeId | ua.NodeId | None) -> ua.NodeId:
        """Return a node id with its index in this session; an id of another server is null."""
        if node_id is None or getattr(node_id, "ServerIndex", None):
            return ua.NodeId()
        uri = getattr(node_id, "NamespaceUri", None)
        index = node_id.NamespaceIndex
        if uri:
            if uri not in self._namespaces:
                return ua.NodeId()
            index = list(self._namespaces).index(uri)
        return ua.NodeId(node_id.Identifier, index)

    def _check_count(self, results: Sequence[object], expected: int) -> None:
        if len(results) != expected:
            raise self._nonsense_error("it answered to more or fewer nodes than it was asked about")

    def _check_status(self, status: ua.StatusCode) -> None:
        if not status.is_good():
            raise RefusedError(
                self._link.device,
                make_message("the OPC UA server does not show a node ({status}).", status=status.name),
                remedy="Allow reading of all nodes on the server, then try again.",
                vendor_code=int(status.value),
                vendor_text=status.name,
            )

    def _nonsense_error(self, why: str) -> WireProtocolError:
        return WireProtocolError(
            self._link.device,
            make_message("the OPC UA server cannot be followed: {why}.", why=why),
            remedy=_REPORT,
        )
