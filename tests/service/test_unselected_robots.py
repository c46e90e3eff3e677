"""The robots that are not selected: what they lose and how they stand is told, and disturbs no run. Over sockets."""

import asyncio
from pathlib import Path
from typing import Any

from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.export.cell_metrics import CellMetrics
from cellcal.service.record.healthy_counts import LastHealthyCounts
from cellcal.service.record.journal_files import lease_folder
from cellcal.service.record.robot_lock import DEVICES, acquire_lease
from cellcal.service.site.alarms import list_alarms
from tests.machine_speed import stretched_s
from tests.service.cell_process_session import (
    RECORD,
    ScreenSession,
    confirm_until_end,
    open_session,
    run_outcome,
    take_the_record,
)


async def test_an_unselected_robot_that_loses_its_encoders_is_named_and_recovered_once_it_is_selected(
    tmp_path: Path,
) -> None:
    async with open_session(tmp_path, time_factor=1000.0) as person:
        await take_the_record(person)
        await select_robot(person, "ur")
        await until_device(
            person, "fanuc", lambda device: device["role"] == "other_robot" and device["value"]
        )
        await person.fake_client.inject_fault("battery_loss", axes="all")
        (loss,) = await person.wait_until(lambda session: session["losses"])
        assert (loss["robot"], loss["procedure"], loss["mode"]) == ("fanuc", "mastering_recovery", "M1")
        assert "another robot was selected at the desk" in loss["reasons"]
        await until_device(person, "fanuc", lambda device: device["state"] == "position_lost")
        codes = {(alarm.code, alarm.source) for alarm in list_alarms(person.session, person.live)}
        assert {("position.lost", "fanuc"), ("device.position_lost", "fanuc")} <= codes
        await select_robot(person, "fanuc")
        assert [each["robot"] for each in person.session["losses"]] == ["fanuc"]
        recovery = {"op": "start", "procedure": "mastering_recovery", "settings": loss["settings"]}
        assert (await person.send_order(recovery | {"hold_to_move": False}))["ok"]
        await confirm_until_end(person)
        assert (await run_outcome(person))["outcome"]["verdict"] == "passed"
        await person.wait_until(lambda session: not session["losses"])


async def test_a_stop_of_an_unselected_robot_reaches_site_and_metrics_during_a_run(
    tmp_path: Path,
) -> None:
    async with open_session(tmp_path) as person:
        await until_device(person, "ur", lambda device: device["state"] == "ready" and device["value"])
        assert len(device_of(person, "ur")["value"]["joints_rad"]) == 6
        await person.send_order(RECORD | {"hold_to_move": False})
        await person.answer_question("wire_is_hooked")
        await person.wait_until(lambda session: (session["prompt"] or {}).get("key") == "accept_plan")
        rev = person.cell_process.rev
        await person.fake_client.inject_fault("protective_stop", device="ur")
        await until_device(person, "ur", lambda device: device["state"] == "stopped")
        (alarm,) = [each for each in list_alarms(person.session, person.live) if each.source == "ur"]
        assert (alarm.code, "protective stop" in alarm.text) == ("device.stopped", True)
        meter = CellMetrics(read_cell_file(person.cell_file))
        meter.on_event("session", person.session)
        meter.on_event("live", person.live)
        assert (
            'cellcal_device_state{device="ur",role="other_robot",state="stopped"} 1' in meter.render_metrics()
        )
        assert person.cell_process.rev == rev  # what the person looks at is not out of date by it
        await person.answer_question("accept_plan")
        await person.wait_until(lambda session: "capture 1" in session["run"]["found"])
        await person.fake_client.inject_fault("unlock_protective_stop", device="ur")
        await until_device(person, "ur", lambda device: device["state"] == "ready")
        await person.send_order({"op": "stop"})


async def test_an_unselected_robot_that_is_cut_off_is_reported_and_found_again(tmp_path: Path) -> None:
    async with open_session(tmp_path) as person:
        await until_device(person, "ur", lambda device: device["state"] == "ready")
        await person.fake_client.inject_fault("link_loss_all", device="ur")
        device_state = await until_device(person, "ur", lambda device: device["state"] == "unreachable")
        assert device_state["message"]
        assert person.session["connection"]["connected"]
        await person.fake_client.inject_fault("link_restore", device="ur")
        await until_device(person, "ur", lambda device: device["state"] == "ready")


async def test_a_robot_that_another_cellcal_has_is_left_to_it(tmp_path: Path) -> None:
    async with open_session(tmp_path) as person:
        await until_device(person, "ur", lambda device: device["state"] == "ready")
        config = read_cell_file(person.cell_file)
        with acquire_lease(lease_folder(config), config.robot_named("ur").serial, "a test", DEVICES):
            device_state = await until_device(person, "ur", lambda device: device["state"] == "unknown")
            assert "another cellcal" in device_state["message"]
            assert not [each for each in list_alarms(person.session, person.live) if each.source == "ur"]
        await until_device(person, "ur", lambda device: device["state"] == "ready")


async def test_other_robots_are_reported_while_the_selected_robot_is_unreachable(tmp_path: Path) -> None:
    async with open_session(tmp_path) as person:
        memory = LastHealthyCounts(read_cell_file(person.cell_file).cell.data_dir)
        await select_robot(person, "ur")
        await person.wait_until(lambda _: memory.load_counts("fanuc"))
        await person.fake_client.inject_fault("link_loss_all", device="ur")
        await person.wait_until(lambda session: not session["connection"]["connected"])
        await person.fake_client.inject_fault("battery_loss", axes="all")
        (loss,) = await person.wait_until(lambda session: session["losses"])
        assert loss["robot"] == "fanuc"
        await until_device(person, "fanuc", lambda device: device["state"] == "position_lost")


async def select_robot(person: ScreenSession, robot: str) -> None:
    await person.send_order({"op": "select_robot", "robot": robot})
    await person.wait_until(lambda session: session["robot"] == robot and session["connection"]["connected"])


def device_of(person: ScreenSession, name: str) -> dict[str, Any]:
    found = [device for device in person.live.get("devices", []) if device["name"] == name]
    assert len(found) < 2
    return found[0] if found else {"state": "", "role": "", "value": None}


async def until_device(person: ScreenSession, name: str, true: Any) -> dict[str, Any]:
    async with asyncio.timeout(stretched_s(90.0)):
        while not true(device_of(person, name)):
            await asyncio.sleep(0.02)
    return device_of(person, name)
