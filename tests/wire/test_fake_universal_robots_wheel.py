"""The unmodified ur_rtde wheel connects to the fake controller, moves it, reads it, and sees its stops."""

import asyncio
from typing import Any

import pytest

from tests.machine_speed import stretched_s
from tests.wire.fake_ur import fake_ur, run_wheel
from tests.wire.rtde_client import start_client

pytestmark = pytest.mark.timeout(stretched_s(110.0))


@pytest.mark.parametrize("software", ["5.11.1", "10.11.0", "10.12.1"])
async def test_every_kind_of_move_arrives(software: str) -> None:
    settings = {"software": software}
    async with fake_ur(time_factor=20.0, settings=settings) as robot, run_wheel(robot, "moves") as child:
        found = await child.read_line()
        assert [name for name, good in found.items() if good is not True] == []


async def test_answers_of_the_control_program_are_right_and_stale_where_the_real_ones_are() -> None:
    found: dict[str, Any] = {}
    for _ in range(5):  # what is stale is stale for a moment only: a busy machine may ask too late
        async with fake_ur() as robot, run_wheel(robot, "answers") as child:
            found = await child.read_line()
        if found["stale"] == pytest.approx(found["pose trans"]):
            break
    assert max(found["fk"], found["fk of q"]) < 1e-12
    assert found["ik"] < 1e-9
    assert found["tcp"] == [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]
    assert found["pose trans"] == pytest.approx([1.0, 2.0, 0.0, 0.0, 0.0, 0.5])
    assert (found["ik far"], found["outside"]) == (False, False)
    assert found["stale"] == pytest.approx([1.0, 2.0, 0.0, 0.0, 0.0, 0.5])
    assert found["flange to tip"] == pytest.approx(0.1)
    assert found["unreachable"] == []
    assert [found[key] for key in ("script died", "back", "watchdog bit")] == [True] * 3


async def test_the_dashboard_and_the_inputs_and_outputs() -> None:
    async with fake_ur() as robot, run_wheel(robot, "dashboard") as child:
        found = await child.read_line()
    assert found == {
        "version": "5.11.1.108318",
        "serial": "20225500042",
        "model": "UR10",
        "remote": True,
        "mode": "Robotmode: RUNNING",
        "safety": "Safetymode: NORMAL",
        "state": "STOPPED cell.urp",
        "output": True,
        "slider": True,
    }


@pytest.mark.parametrize(
    ("fault", "cure", "expected_flags"),
    [
        ("protective_stop", "unlock_protective_stop", {"protective": True, "emergency": False}),
        ("emergency_stop", "release_emergency_stop", {"protective": False, "emergency": True}),
        ("program_stop", None, {"protective": False, "emergency": False}),
        ("program_pause", None, {"protective": False, "emergency": False}),
    ],
)
async def test_a_stopped_move_is_false_and_the_robot_moves_again_after_the_cure(
    fault: str, cure: str | None, expected_flags: dict[str, bool]
) -> None:
    async with fake_ur(time_factor=2.0) as robot, run_wheel(robot, "stopped_in_a_move") as child:
        assert await child.read_line() == {"ready": True}
        watch = await start_client(robot.server.address, ["actual_qd"])
        async with watch:
            await child.go_on()
            while (await watch.read_package())["actual_qd"][0] < 0.01:
                pass
        await robot.inject_fault(fault, {})
        found = await child.read_line()
        assert found["arrived"] is False
        assert {key: found[key] for key in expected_flags} == expected_flags
        assert 0.0 < found["gone"] < 1.0
        if cure is not None:
            await robot.inject_fault(cure, {})
        await child.go_on()
        assert await child.read_line() == {"home": True}


async def test_registers_in_use_are_refused() -> None:
    async with fake_ur() as robot:
        await robot.inject_fault("in_use", {})
        async with run_wheel(robot, "second_client") as child:
            assert "in use" in (await child.read_line())["refused"].lower()


@pytest.mark.parametrize("software", ["3.15.8", "5.11.1", "10.12.1"])
async def test_a_receiver_sees_a_cut_link_and_comes_back(software: str) -> None:
    async with fake_ur(settings={"software": software}) as robot, run_wheel(robot, "receive_only") as child:
        assert await child.read_line() == {"connected": True}
        await robot.inject_fault("link_loss_all", {})
        await child.go_on()
        assert await child.read_line() == {"lost": True}
        await robot.inject_fault("link_restore", {})
        await child.go_on()
        found = await child.read_line()
        assert found["again"] is True
        assert found["q"] == pytest.approx(robot.true_state()["joints_rad"])


async def test_a_silent_controller_hangs_the_wheel_not_us() -> None:
    async with fake_ur() as robot:
        await robot.inject_fault("silent_accept", {})
        async with run_wheel(robot, "second_client") as child:
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(child.read_line(), 1.5)
            assert child.process.returncode is None


async def test_the_program_outlives_its_client_and_the_next_one_takes_over() -> None:
    async with fake_ur(time_factor=20.0) as robot:
        async with run_wheel(robot, "stopped_in_a_move") as child:
            assert await child.read_line() == {"ready": True}
        assert robot.true_state()["program"] == "rtde_control"
        async with run_wheel(robot, "answers") as child:
            assert (await child.read_line())["back"] is True
