"""One client's connection: messages of UA TCP taken apart, requests answered.

Imitates
    An OPC UA server over opc.tcp: without message security and sign-in, or with a guard (server_guard.py).
Source
    OPC 10000-4 (services) and OPC 10000-6 (UA TCP, binary encoding); asyncua takes octets apart
    and puts them together.
Modelled
    Hello, secure channel and its renewal, sessions that a restart forgets, GetEndpoints, Browse, BrowseNext,
    TranslateBrowsePathsToNodeIds, Read. Any other service is refused with BadServiceUnsupported.
Not modelled
    Subscriptions, discovery of other servers, more than one endpoint.
"""

import itertools
import secrets
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from asyncua import ua
from asyncua.common.connection import SecureConnection, TransportLimits
from asyncua.common.utils import Buffer
from asyncua.crypto.security_policies import SecurityPolicyNone
from asyncua.ua.ua_binary import nodeid_from_binary, struct_from_binary, struct_to_binary, uatcp_to_binary

from cellcal.fake_devices.opc_ua.node_table import NodeTable
from cellcal.fake_devices.opc_ua.server_guard import ServerGuard

_PRODUCT = "urn:cellcal:fake:robot-server"
_SESSION_MS = 60_000.0
_ANONYMOUS, _BY_NAME = "anonymous", "user"


@dataclass
class ServerState:
    """The state that all connections of one server share; a restart makes it anew."""

    table: NodeTable
    endpoint: str
    guard: ServerGuard | None = None  # None: no sign-in and no encryption
    sessions: set[ua.NodeId] = field(default_factory=set)  # authentication tokens
    numbers: Iterator[int] = field(default_factory=lambda: itertools.count(100))

    def get_new_channel_id(self) -> int:
        """Return the number of the next secure channel; asyncua asks for it under this name."""
        return next(self.numbers)

    def describe_endpoint(self) -> ua.EndpointDescription:
        """Return the only way in: no security, anonymous."""
        guard = self.guard
        token = ua.UserTokenPolicy(_ANONYMOUS, ua.UserTokenType.Anonymous)
        if guard is not None and guard.users:
            token = ua.UserTokenPolicy(_BY_NAME, ua.UserTokenType.UserName)
        server = ua.ApplicationDescription(
            _PRODUCT, _PRODUCT, ua.LocalizedText("robot server"), ua.ApplicationType.Server
        )
        server.DiscoveryUrls = [self.endpoint]
        return ua.EndpointDescription(
            EndpointUrl=self.endpoint,
            Server=server,
            ServerCertificate=None if guard is None else guard.certificate_der,
            SecurityMode=ua.MessageSecurityMode.None_ if guard is None else guard.MODE,
            SecurityPolicyUri=SecurityPolicyNone.URI if guard is None else guard.POLICY.URI,
            UserIdentityTokens=[token],
            TransportProfileUri="http://opcfoundation.org/UA-Profile/Transport/uatcp-uasc-uabinary",
        )


class ClientConnection:
    """Answers the messages of one client."""

    def __init__(self, state: ServerState) -> None:
        self._state = state
        self._limits = TransportLimits()
        self._channel = SecureConnection(SecurityPolicyNone(), self._limits)
        self._nonce = b""
        if state.guard is not None:
            self._channel.set_policy_factories([state.guard.make_factory()])
        self._services: Mapping[int, Callable[[Buffer], Any]] = {
            ua.ObjectIds.GetEndpointsRequest_Encoding_DefaultBinary: self._get_endpoints,
            ua.ObjectIds.CreateSessionRequest_Encoding_DefaultBinary: self._create_session,
            ua.ObjectIds.ActivateSessionRequest_Encoding_DefaultBinary: self._activate_session,
            ua.ObjectIds.CloseSessionRequest_Encoding_DefaultBinary: self._close_session,
            ua.ObjectIds.BrowseRequest_Encoding_DefaultBinary: self._browse_nodes,
            ua.ObjectIds.BrowseNextRequest_Encoding_DefaultBinary: self._browse_next,
            ua.ObjectIds.TranslateBrowsePathsToNodeIdsRequest_Encoding_DefaultBinary: self._translate_paths,
            ua.ObjectIds.ReadRequest_Encoding_DefaultBinary: self._read_nodes,
        }
        self._without_session = (self._get_endpoints, self._create_session)

    def answer(self, header: ua.Header, body: Buffer) -> bytes | None:
        """Return the answer to a message: b"" where none is due yet, None where the client has closed the channel."""
        message = self._channel.receive_from_header_and_body(header, body)
        if isinstance(message, ua.Hello):
            limits = self._limits.create_acknowledge_and_set_limits(message)
            return bytes(uatcp_to_binary(ua.MessageType.Acknowledge, limits))
        if header.MessageType == ua.MessageType.SecureClose:
            return None
        if not isinstance(message, ua.Message):
            return b""
        number = message.SequenceHeader().RequestId
        if header.MessageType == ua.MessageType.SecureOpen:
            return self._open_channel(message.body(), number)
        return self._answer_request(message.body(), number)

    def _open_channel(self, body: Buffer, number: int) -> bytes:
        request = struct_from_binary(ua.OpenSecureChannelRequest, body)
        guard, policy = self._state.guard, self._channel.security_policy
        if guard is not None and (policy.URI, request.Parameters.SecurityMode) != (
            guard.POLICY.URI,
            guard.MODE,
        ):
            refused = ua.StatusCode(ua.UInt32(ua.StatusCodes.BadSecurityPolicyRejected))
            return bytes(uatcp_to_binary(ua.MessageType.Error, ua.ErrorMessage(refused, "not encrypted")))
        response = ua.OpenSecureChannelResponse()
        response.Parameters = self._channel.open(request.Parameters, self._state)
        return self._frame_response(response, request.RequestHeader, number, ua.MessageType.SecureOpen)

    def _answer_request(self, body: Buffer, number: int) -> bytes:
        service = self._services.get(nodeid_from_binary(body).Identifier)
        header = struct_from_binary(ua.RequestHeader, body)
        if service is None:
            response = _service_fault(ua.StatusCodes.BadServiceUnsupported)
        elif service not in self._without_session and header.AuthenticationToken not in self._state.sessions:
            response = _service_fault(ua.StatusCodes.BadSessionIdInvalid)
        else:
            response = service(body)
            if service == self._close_session:
                self._state.sessions.discard(header.AuthenticationToken)
        return self._frame_response(response, header, number, ua.MessageType.SecureMessage)

    def _frame_response(
        self, response: Any, header: ua.RequestHeader, number: int, kind: ua.MessageType
    ) -> bytes:
        response.ResponseHeader.RequestHandle = header.RequestHandle
        octets = struct_to_binary(response)
        return bytes(self._channel.message_to_binary(octets, message_type=kind, request_id=number))

    def _get_endpoints(self, body: Buffer) -> Any:
        del body
        response = ua.GetEndpointsResponse()
        response.Endpoints = [self._state.describe_endpoint()]
        return response

    def _create_session(self, body: Buffer) -> Any:
        request = struct_from_binary(ua.CreateSessionParameters, body)
        token = ua.NodeId(next(self._state.numbers), 1)
        self._state.sessions.add(token)
        response = ua.CreateSessionResponse()
        result = response.Parameters
        result.SessionId, result.AuthenticationToken = ua.NodeId(next(self._state.numbers), 1), token
        result.RevisedSessionTimeout = min(_SESSION_MS, request.RequestedSessionTimeout or _SESSION_MS)
        result.ServerNonce = self._nonce = secrets.token_bytes(32)
        policy = self._channel.security_policy
        if policy.host_certificate is not None:
            result.ServerCertificate = policy.host_certificate
            signed = (policy.peer_certificate or b"") + (request.ClientNonce or b"")
            result.ServerSignature.Signature = policy.asymmetric_cryptography.signature(signed)
            result.ServerSignature.Algorithm = policy.AsymmetricSignatureURI
        result.ServerEndpoints = [self._state.describe_endpoint()]
        return response

    def _activate_session(self, body: Buffer) -> Any:
        request = struct_from_binary(ua.ActivateSessionParameters, body)
        policy, guard = self._channel.security_policy, self._state.guard
        if policy.host_certificate is not None:
            signed = policy.host_certificate + self._nonce
            policy.asymmetric_cryptography.verify(signed, request.ClientSignature.Signature)
        if guard is None:
            if isinstance(request.UserIdentityToken, ua.UserNameIdentityToken | ua.X509IdentityToken):
                return _service_fault(ua.StatusCodes.BadIdentityTokenRejected)
        elif not guard.lets_in(request.UserIdentityToken, self._nonce):
            return _service_fault(ua.StatusCodes.BadUserAccessDenied)
        response = ua.ActivateSessionResponse()
        response.Parameters.ServerNonce = self._nonce = secrets.token_bytes(32)
        return response

    def _close_session(self, body: Buffer) -> Any:
        del body
        return ua.CloseSessionResponse()

    def _browse_nodes(self, body: Buffer) -> Any:
        request = struct_from_binary(ua.BrowseParameters, body)
        response = ua.BrowseResponse()
        most = request.RequestedMaxReferencesPerNode
        response.Results = [self._state.table.browse(each, most) for each in request.NodesToBrowse]
        return response

    def _browse_next(self, body: Buffer) -> Any:
        request = struct_from_binary(ua.BrowseNextParameters, body)
        response = ua.BrowseNextResponse()
        response.Parameters.Results = [
            self._state.table.browse_next(point, release=request.ReleaseContinuationPoints)
            for point in request.ContinuationPoints
        ]
        return response

    def _translate_paths(self, body: Buffer) -> Any:
        request = struct_from_binary(ua.TranslateBrowsePathsToNodeIdsParameters, body)
        response = ua.TranslateBrowsePathsToNodeIdsResponse()
        response.Results = [self._state.table.translate(path) for path in request.BrowsePaths]
        return response

    def _read_nodes(self, body: Buffer) -> Any:
        request = struct_from_binary(ua.ReadParameters, body)
        response = ua.ReadResponse()
        response.Results = [
            self._state.table.read(each.NodeId, int(each.AttributeId)) for each in request.NodesToRead
        ]
        return response


def _service_fault(status: int) -> Any:
    response = ua.ServiceFault()
    response.ResponseHeader.ServiceResult = ua.StatusCode(ua.UInt32(status))
    return response
