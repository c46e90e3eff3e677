"""Controllers over their wires: links cut at any moment, and answers that are damaged."""

import asyncio
import struct
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from cellcal.drivers.abb.robot_web_services.rapid_values import read_numbers, read_tool
from cellcal.drivers.errors import DeviceError
from cellcal.drivers.fanuc.rmi.rmi_link import RmiLink
from cellcal.drivers.kuka.variables.values import read_axes, read_pose
from cellcal.drivers.kuka.variables.variable_link import VariableLink
from cellcal.drivers.universal_robots.factory_calibration import decode_arm, decode_kinematics
from cellcal.drivers.universal_robots.primary_interface import _collect
from cellcal.drivers.universal_robots.robot_api import RobotApiClient
from cellcal.drivers.yaskawa.hses_frames import read_answer
from cellcal.drivers.yaskawa.tool_file import read_tools
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.soak.campaign_figures import CampaignFigures
from tests.soak.input_mutations import mutated_input
from tests.soak.opc_ua_answers import example_answer, read_opc_ua_answer
from tests.wire.driver_cases import open_retrying
from tests.wire.fake_devices_process import run_fakes
from tests.wire.link_cuts import cut_links
from tests.wire.robot_cases import ROBOTS

_SLOW_S = 2.0


def rmi_cuts(count: int) -> CampaignFigures:
    """Cut the link of the Remote Motion Interface so many times at random moments of moves."""
    case = ROBOTS["fanuc_rmi"]

    async def play(path: Path, fake_client: FakeCellClient) -> tuple[int, int]:
        async with open_retrying(read_cell_file(path).robot_named(case.name)) as robot:
            await case.heal(fake_client, robot)
            return await cut_links(robot, case, fake_client, count, "hang_up")

    with tempfile.TemporaryDirectory() as folder, run_fakes(Path(folder)) as (path, fake_client):
        missed, most_queued = asyncio.run(play(path, fake_client))
    line = f"links cut {count}, moves after it that missed {missed}, longest queue {most_queued}"
    return CampaignFigures(line, missed == 0 and most_queued <= 1)


AXES = b"{E6AXIS: A1 10.0, A2 -90.0, A3 90.0, A4 0.0, A5 15.0, A6 -7.0, E1 0.0, E2 0.0}"
POSE = b"{E6POS: X 10.0, Y -5.5, Z 1200.25, A 90.0, B 0.5, C -12.0, S 2, T 35, E1 0.0}"
TOOL = b"[TRUE,[[31.4,0,229.14],[0.707107,0,0.707107,0]],[2.5,[0,0,100],[1,0,0,0],0,0,0]]"
JOINT_TARGET = b"[[5.73,-11.46,17.19,0.5,-28.65,90],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]]"
TOOLS = b"//TOOL 0\r\n///NAME A\r\n-88.687,0.981,463.147,0.0,-45.0,0.0\r\n-4.0,0.0,118.0\r\n2.48\r\n0,0,0\r\n"
HSES = bytes.fromhex(
    "59455243200008000301010000000080393939393939393981000000000000 00c400000040000000".replace(" ", "")
)
FRAME = bytes.fromhex("0001000d00000763616c6c63656c000101")
PACKET = b'{"Command": "FRC_ReadJointAngles", "ErrorID": 0, "JointAngle": {"J1": 10.0, "J2": 20.0}}'


def _read_text(read: Callable[[str], object]) -> Callable[[bytes], object]:
    return lambda data: read(data.decode("ascii", "replace"))


def _read_frame(data: bytes) -> str:
    """Let the link of KUKA variables read what a server sends, to its end."""

    async def read() -> str:
        reader = asyncio.StreamReader()
        reader.feed_data(data)
        reader.feed_eof()
        link = VariableLink("kuka", "127.0.0.1", 7000, deadline_s=1.0)
        link.expect_tag(1)
        return await link.read_answer(reader, 0, "CALLCEL")

    return asyncio.run(read())


def _read_packet(data: bytes) -> object:
    return RmiLink("rmi", "127.0.0.1", 16001, deadline_s=1.0).decode_packet(data)


def _primary_bytes() -> bytes:
    arm = struct.pack(">53d", *([-6.28, 6.28] * 6 + [3.14, 40.0] * 6 + [1.0] * 5 + [0.1] * 24))
    parts = (5, struct.pack(">6I24dI", *[7] * 6, *[0.1] * 24, 2)), (6, arm + struct.pack(">4i", 0, 0, 2, 2))
    body = b"".join(struct.pack(">IB", 5 + len(data), kind) + data for kind, data in parts)
    return struct.pack(">iB", 5 + len(body), 16) + body


def _read_primary(data: bytes) -> object:
    """Let the reader of a UR's primary interface read what a controller sends, to its end."""

    async def read() -> object:
        reader = asyncio.StreamReader()
        reader.feed_data(data)
        reader.feed_eof()
        found = await _collect("ur", reader, (5, 6))
        arm = decode_arm("ur", found[6], decode_kinematics("ur", found[5]))
        return arm.factory.name

    return asyncio.run(read())


def _read_robot_api(data: bytes) -> object:
    return _ROBOT_API.decode_answer(data)


_ROBOT_API = RobotApiClient("ur", "127.0.0.1", 80, deadline_s=1.0)
MODE = b'{"mode": "REMOTE", "details": [1, 2.5, null, true, "x"]}'

READERS: dict[str, tuple[Callable[[bytes], object], bytes]] = {
    "kuka axes": (_read_text(read_axes), AXES),
    "kuka pose": (_read_text(read_pose), POSE),
    "kuka frame": (_read_frame, FRAME),
    "abb numbers": (_read_text(read_numbers), JOINT_TARGET),
    "abb tool": (_read_text(read_tool), TOOL),
    "yaskawa answer": (lambda data: read_answer(data, 1), HSES),
    "yaskawa tools": (_read_text(read_tools), TOOLS),
    "fanuc packet": (_read_packet, PACKET),
    "ur primary interface": (_read_primary, _primary_bytes()),
    "ur robot api": (_read_robot_api, MODE),
    "opc ua values": (read_opc_ua_answer, example_answer()),
}


def wire_answers(count: int) -> CampaignFigures:
    """Read so many damaged answers of each kind: each is read, or refused in a way that the driver expects."""
    refused = unexpected = slow = 0
    for name, (read, example) in READERS.items():
        for seed in range(count):
            began_s = time.perf_counter()
            try:
                read(mutated_input(example, seed))
            except (ValueError, DeviceError, asyncio.IncompleteReadError):
                refused += 1
            except Exception as error:
                unexpected += 1
                print(f"{name}, seed {seed}: {error!r}")
            slow += time.perf_counter() - began_s > _SLOW_S
    line = f"answers {count * len(READERS)}, refused {refused}, unexpected errors {unexpected}, slow {slow}"
    return CampaignFigures(line, unexpected == 0 and slow == 0)
