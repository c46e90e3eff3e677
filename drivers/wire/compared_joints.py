"""Joint angles of an arm that stands, by a stream and by the robot's own link, which must agree."""

import logging
import math
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import UnreachableError, WireProtocolError
from cellcal.drivers.interfaces import JointReading, Joints
from cellcal.drivers.wire.joint_stream import JointStream, StreamReading

_LOG = logging.getLogger(__name__)
_TRIES = 3  # readings of the other link until the arm stood through one


@dataclass(frozen=True, slots=True)
class JointComparison:
    """The comparison of both links' joints, and the state of the stream."""

    difference_rad: float | None  # largest of all axes; None: the arm moves
    rate_hz: float


class ComparedJoints:
    """A stream that says whether the arm stands, beside the link that commands it.

    The other link stays the one that moves and stops the robot. ``takes_stream`` says whose angles are given of an
    arm that stands: the stream's, where its numbers are the finer ones.
    """

    def __init__(
        self,
        stream: JointStream,
        other_link: str,
        read_other: Callable[[], Awaitable[Joints]],
        *,
        takes_stream: bool,
    ) -> None:
        self.stream = stream
        self.other_link, self._read_other, self._takes_stream = other_link, read_other, takes_stream
        self._is_silent = False
        self._obstacle: UnreachableError | None = None  # why nothing can be received

    async def open(self) -> None:
        """Listen. Where that is not possible the robot is used without the stream: it must be stopped at any time."""
        try:
            await self.stream.open()
        except UnreachableError as error:
            _LOG.warning("%s", error)
            self._obstacle = error

    async def read(self) -> JointReading | None:
        """Return the joints; None where no stream comes, which the log says once.

        Raises
        ------
        WireProtocolError
            The arm stands, and the links differ by more than the cell file allows.
        """
        if self._obstacle is not None:
            return None
        for tries_left in reversed(range(_TRIES)):
            asked_at_s = time.monotonic()
            joints = await self._read_other()
            reading = await self.stream.read()
            self._note_silence(is_silent=reading is None)
            if reading is None:
                return None
            throughout = self.stream.stood_since(asked_at_s)
            if throughout.is_still:
                self._difference(throughout, joints)
                shown = throughout.joints_rad if self._takes_stream else joints
                return self._as_joints(shown, throughout, moving=False)
            if not (reading.is_still and tries_left):  # it moves, or moved through each of several readings
                return self._as_joints(joints, reading, moving=True)
        return None

    def _as_joints(self, joints: Joints, reading: StreamReading, *, moving: bool) -> JointReading:
        raw = f"{self.stream.link} {reading.raw}"
        return JointReading(joints, moving, reading.taken_at_s, reading.sent_at_s, raw)

    async def compare(self) -> JointComparison | None:
        """Return how far both links are apart; None where no stream comes.

        Raises
        ------
        UnreachableError
            Nothing can be received at the address and port of the cell file.
        WireProtocolError
            As ``read``.
        """
        if self._obstacle is not None:
            raise self._obstacle
        asked_at_s = time.monotonic()
        joints = await self._read_other()
        if await self.stream.read() is None:
            return None
        throughout = self.stream.stood_since(asked_at_s)
        apart_rad = self._difference(throughout, joints) if throughout.is_still else None
        return JointComparison(apart_rad, self.stream.rate_hz())

    def _difference(self, reading: StreamReading, joints: Joints) -> float:
        differences = [abs(a - b) for a, b in zip(reading.joints_rad, joints, strict=True)]
        axis = differences.index(max(differences))
        if differences[axis] > math.radians(self.stream.settings.agree_deg):
            raise WireProtocolError(
                self.stream.device,
                make_message(
                    "{link} shows axis {axis} at {stream_deg:.4f} deg and {other_link} at {other_deg:.4f} deg.",
                    link=self.stream.link,
                    axis=axis + 1,
                    stream_deg=math.degrees(reading.joints_rad[axis]),
                    other_link=self.other_link,
                    other_deg=math.degrees(joints[axis]),
                ),
                remedy="Check that both come from the same controller and arm, then compare with the pendant.",
                frame=reading.raw,
            )
        return differences[axis]

    def _note_silence(self, *, is_silent: bool) -> None:
        if is_silent and not self._is_silent:
            _LOG.warning(
                "%s: no %s comes: the joints are read over %s alone", self.stream.device, self.stream.link,
                self.other_link,
            )  # fmt: skip
        elif self._is_silent and not is_silent:
            _LOG.info("%s: %s comes again", self.stream.device, self.stream.link)
        self._is_silent = is_silent


async def describe_sources(compared: ComparedJoints) -> str:
    """Return in a sentence what comes from the stream. Errors as ``ComparedJoints.compare``."""
    found = await compared.compare()
    link, port = compared.stream.link, compared.stream.settings.port
    if found is None:
        return make_message(
            "No {link} comes at port {port}: joints are read without it.", link=link, port=port
        )
    if found.difference_rad is None:
        return make_message(
            "{link}: {rate_hz:.0f} readings a second, the arm moves.", link=link, rate_hz=found.rate_hz
        )
    return make_message(
        "{link}: {rate_hz:.0f} readings a second, within {difference_deg:.4f} deg of {other_link}.",
        link=link,
        rate_hz=found.rate_hz,
        difference_deg=math.degrees(found.difference_rad),
        other_link=compared.other_link,
    )
