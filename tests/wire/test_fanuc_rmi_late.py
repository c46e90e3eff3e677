"""A reply of the Remote Motion Interface that comes late, twice or in pieces never answers another question."""

import asyncio
import json
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from cellcal.drivers.errors import RefusedError, WireProtocolError
from cellcal.drivers.fanuc.rmi.rmi_link import RmiLink
from cellcal.drivers.fanuc.rmi.rmi_state import read_frame, read_joint_angles
from cellcal.fake_devices.listening_port import ListeningPort
from tests.machine_speed import stretched_s

DEADLINE_S = stretched_s(4.0)


class SlowController:
    """Numbers the questions of all connections; J1 of a reply is the number of its question."""

    def __init__(self) -> None:
        self.arrivals = asyncio.Semaphore(0)
        self.may_answer = asyncio.Event()
        self.may_answer.set()
        self.never_answers = False
        self.copies = 1  # of each reply
        self.later: list[bytes] = []  # sent before the next reply
        self.pieces_of = 0  # octets a segment; 0: whole replies
        self.questions = 0
        self.clients: list[asyncio.StreamWriter] = []

    async def name_port(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readline()
        self._send(writer, Communication="FRC_Connect", PortNumber=self.port, MajorVersion=4, MinorVersion=1)

    async def answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.clients.append(writer)
        while line := await reader.readline():
            self.questions += 1
            number, name = self.questions, json.loads(line).get("Command")
            self.arrivals.release()
            await self.may_answer.wait()
            if name is None or self.never_answers:
                continue
            angles = {f"J{axis}": float(number) for axis in range(1, 7)}
            await self._send_reply(
                writer, Command=name, JointAngle=angles, UFrameNumber=1, UToolNumber=number
            )

    async def _send_reply(self, writer: asyncio.StreamWriter, **fields: object) -> None:
        octets = (
            b"".join(self.later) + (json.dumps({**fields, "ErrorID": 0}).encode() + b"\r\n") * self.copies
        )
        self.later.clear()
        size = self.pieces_of or len(octets)
        for start in range(0, len(octets), size):
            writer.write(octets[start : start + size])
            await writer.drain()
            await asyncio.sleep(0)

    @asynccontextmanager
    async def running(self) -> AsyncIterator[RmiLink]:
        async with (
            ListeningPort("127.0.0.1", 0, self.answer) as second,
            ListeningPort("127.0.0.1", 0, self.name_port) as first,
        ):
            self.port = second.port
            link = RmiLink("rmi", "127.0.0.1", first.port, deadline_s=DEADLINE_S)
            try:
                yield link
            finally:
                self.may_answer.set()
                await link.close()

    def _send(self, writer: asyncio.StreamWriter, **fields: object) -> None:
        writer.write(json.dumps({**fields, "ErrorID": 0}).encode() + b"\r\n")


async def number_told(link: RmiLink) -> int:
    joints, _ = await read_joint_angles(link)
    return round(math.degrees(joints[0]))


async def give_up_reading(controller: SlowController, link: RmiLink) -> None:
    reading = asyncio.create_task(number_told(link))
    await controller.arrivals.acquire()
    reading.cancel()
    with pytest.raises(asyncio.CancelledError):
        await reading


async def test_a_late_reply_does_not_answer_the_next_question() -> None:
    controller = SlowController()
    async with controller.running() as link:
        assert await number_told(link) == 1
        await controller.arrivals.acquire()
        controller.may_answer.clear()
        await give_up_reading(controller, link)
        asyncio.get_running_loop().call_soon(controller.may_answer.set)
        assert [await number_told(link) for _ in range(3)] == [3, 4, 5]
        assert len(controller.clients) == 1


async def test_another_question_does_not_wait_for_a_late_reply() -> None:
    controller = SlowController()
    async with controller.running() as link:
        await link.open()
        controller.may_answer.clear()
        await give_up_reading(controller, link)
        controller.may_answer.set()
        assert (await link.send_command("FRC_GetUFrameUTool"))["UToolNumber"] == 2
        assert await number_told(link) == 3


async def test_a_reply_that_never_comes_ends_the_connection() -> None:
    controller = SlowController()
    async with controller.running() as link:
        await link.open()
        controller.never_answers = True
        await give_up_reading(controller, link)
        controller.never_answers = False
        assert await number_told(link) == 2
        assert len(controller.clients) == 2


@pytest.mark.parametrize("octets", [1, 2, 7, 0])
async def test_a_reply_in_pieces_is_one_reply(octets: int) -> None:
    controller = SlowController()
    controller.pieces_of = octets
    async with controller.running() as link:
        assert [await number_told(link) for _ in range(3)] == [1, 2, 3]
        assert len(controller.clients) == 1


async def test_a_reply_that_comes_twice_answers_one_question() -> None:
    controller = SlowController()
    async with controller.running() as link:
        controller.copies = 2
        assert await number_told(link) == 1
        controller.copies = 1
        assert [await number_told(link) for _ in range(3)] == [2, 3, 4]
        assert len(controller.clients) == 2  # made anew


async def test_a_second_reply_that_meets_the_next_question_ends_the_connection() -> None:
    controller = SlowController()
    async with controller.running() as link:
        assert await number_told(link) == 1
        late = {
            "Command": "FRC_ReadJointAngles",
            "JointAngle": {f"J{n}": 1.0 for n in range(1, 7)},
            "ErrorID": 0,
        }
        controller.later = [json.dumps(late).encode() + b"\r\n"]
        assert await number_told(link) == 1  # nothing tells it from a right one before the next reply comes
        assert [await number_told(link) for _ in range(2)] == [3, 4]
        assert len(controller.clients) == 2
        for lates in (1, 2):  # in the same segment as the right one, and one behind each of two
            controller.later = [json.dumps(late).encode() + b"\r\n"] * lates
            with pytest.raises(WireProtocolError, match="nothing had asked"):
                async with link.confirmed_answers():
                    await number_told(link)
        async with link.confirmed_answers():
            assert await number_told(link) > 4


async def test_a_frame_of_another_number_is_not_the_one_that_was_asked_for() -> None:
    controller = SlowController()
    async with controller.running() as link:
        await link.send_command("FRC_GetUFrameUTool")
        with pytest.raises(WireProtocolError, match="another frame"):
            await read_frame(link, "UTool", 7)  # the second reply tells of tool 2


async def test_replies_to_motions_count_once_and_foreign_numbers_never() -> None:
    controller = SlowController()
    async with controller.running() as link:
        assert await number_told(link) == 1
        executed = await link.send_instruction("FRC_JointMotionJRep", 5)
        (client,) = controller.clients
        for number in (4, 6, 1):
            controller._send(client, Instruction="FRC_JointMotionJRep", SequenceID=number)
        assert await number_told(link) == 3
        assert not executed.done()
        for _ in range(2):
            controller._send(client, Instruction="FRC_JointMotionJRep", SequenceID=5)
        assert (await executed)["SequenceID"] == 5
        following = await link.send_instruction("FRC_JointMotionJRep", 6)
        assert await number_told(link) == 5
        assert not following.done()
        following.cancel()


async def test_a_motion_that_the_controller_cannot_read_is_refused_as_such() -> None:
    controller = SlowController()
    async with controller.running() as link:
        assert await number_told(link) == 1
        executed = await link.send_instruction("FRC_JointMotionJRep", 5)
        (client,) = controller.clients
        client.write(b'{"Command": "Unknown", "ErrorID": 2556957}\r\n')
        reply = await executed
        with pytest.raises(RefusedError, match="RMIT-029"):
            link.accept_reply(reply)
        assert await number_told(link) == 3
        assert len(controller.clients) == 1
