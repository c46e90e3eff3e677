"""Joint moves in short steps by a robot whose joint angles may come by a stream beside its own link."""

from dataclasses import replace

from cellcal.drivers.interfaces import JointReading
from cellcal.drivers.wire.compared_joints import ComparedJoints, describe_sources
from cellcal.drivers.wire.joint_stream import JointStream
from cellcal.drivers.wire.stepwise_motion import StepwiseMotion, StepwiseOptions


class StreamedStepwiseMotion(StepwiseMotion):
    """`StepwiseMotion` whose joints are compared with a stream, where the cell file names one."""

    def __init__(
        self,
        device: str,
        options: StepwiseOptions,
        stream: JointStream | None,
        *,
        own_link: str,
        takes_stream: bool,
    ) -> None:
        """See `ComparedJoints` for ``own_link``, its ``other_link``, and ``takes_stream``."""
        super().__init__(device, options)
        self._compared: ComparedJoints | None = None
        if stream is not None:
            self._compared = ComparedJoints(stream, own_link, self._read_angles, takes_stream=takes_stream)

    async def joint_sources(self) -> str:
        """As the interface ``ComparesJoints`` says."""
        if self._compared is None:
            return ""
        async with self._answer_deadline("comparing the joints"):
            return await describe_sources(self._compared)

    async def _open_stream(self) -> None:
        if self._compared is not None:
            await self._compared.open()

    def _close_stream(self) -> None:
        if self._compared is not None:
            self._compared.stream.close()

    async def _read_compared(self) -> JointReading | None:
        """Return the joints as both links show them; None where no stream comes. Errors as `ComparedJoints.read`."""
        compared = None if self._compared is None else await self._compared.read()
        return None if compared is None else replace(compared, moving=bool(self._doing) or compared.moving)
