"""The robots that are not selected: what they lose and how they stand is told, and disturbs no run. Over sockets."""

import asyncio
from pathlib import Path
from typing import Any

from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.export.cell_metrics import CellMetrics
from cellcal.service.record.healthy_counts import LastHealthyCounts
from cellcal.service.record.journal_files import lease_folder
from cellcal.service.record.robot_lock import DEVICES, acquire_lease
from cellcal.service.site.alarms import wrong_in
from tests.machine_speed import stretched_s
from tests.service.desks import RECORD, AtDesk, at_desk, ended, say_yes_until_it_ends, take_the_record


async def test_an_unselected_robot_that_loses_its_encoders_is_named_and_recovered_once_it_is_selected(
    tmp_path: Path,
) -> None:
    async with at_desk(tmp_path, time_factor=1000.0) as person:
        await take_the_record(person)
        await select(person, "ur")
        await until_device(
            person, "fanuc", lambda device: device["role"] == "other_robot" and device["value"]
        )
        await person.door.inject_fault("battery_loss", axes="all")
        (loss,) = await person.until(lambda session: session["losses"])
        assert (loss["robot"], loss["procedure"], loss["mode"]) == ("fanuc", "mastering_recovery", "M1")
        assert "another robot was selected at the desk" in loss["reasons"]
        await until_device(person, "fanuc", lambda device: device["state"] == "position_lost")
        codes = {(alarm.code, alarm.source) for alarm in wrong_in(person.session, person.live)}
        assert {("position.lost", "fanuc"), ("device.position_lost", "fanuc")} <= codes
        await select(person, "fanuc")
        assert [each["robot"] for each in person.session["losses"]] == ["fanuc"]
        recovery = {"op": "start", "procedure": "mastering_recovery", "settings": loss["settings"]}
        assert (await person.order(recovery | {"hold_to_move": False}))["ok"]
        await say_yes_until_it_ends(person)
        assert (await ended(person))["outcome"]["verdict"] == "passed"
        await person.until(lambda session: not session["losses"])


async def test_a_stop_of_an_unselected_robot_is_told_to_the_site_and_the_figures_amid_a_run(
    tmp_path: Path,
) -> None:
    async with at_desk(tmp_path) as person:
        await until_device(person, "ur", lambda device: device["state"] == "ready" and device["value"])
        assert len(device_of(person, "ur")["value"]["joints_rad"]) == 6
        await person.order(RECORD | {"hold_to_move": False})
        await person.answer("wire_is_hooked")
        await person.until(lambda session: (session["prompt"] or {}).get("key") == "accept_plan")
        rev = person.desk.rev
        await person.door.inject_fault("protective_stop", device="ur")
        await until_device(person, "ur", lambda device: device["state"] == "stopped")
        (alarm,) = [each for each in wrong_in(person.session, person.live) if each.source == "ur"]
        assert (alarm.code, "protective stop" in alarm.text) == ("device.stopped", True)
        meter = CellMetrics(read_cell_file(person.cell_file))
        meter.on_event("session", person.session)
        meter.on_event("live", person.live)
        assert (
            'cellcal_device_state{device="ur",role="other_robot",state="stopped"} 1' in meter.render_metrics()
        )
        assert person.desk.rev == rev  # what the person looks at is not out of date by it
        await person.answer("accept_plan")
        await person.until(lambda session: "capture 1" in session["run"]["found"])
        await person.door.inject_fault("unlock_protective_stop", device="ur")
        await until_device(person, "ur", lambda device: device["state"] == "ready")
        await person.order({"op": "stop"})


async def test_an_unselected_robot_that_is_cut_off_is_told_and_found_again(tmp_path: Path) -> None:
    async with at_desk(tmp_path) as person:
        await until_device(person, "ur", lambda device: device["state"] == "ready")
        await person.door.inject_fault("link_loss_all", device="ur")
        told = await until_device(person, "ur", lambda device: device["state"] == "unreachable")
        assert told["message"]
        assert person.session["connection"]["connected"]
        await person.door.inject_fault("link_restore", device="ur")
        await until_device(person, "ur", lambda device: device["state"] == "ready")


async def test_a_robot_that_another_cellcal_has_is_left_to_it(tmp_path: Path) -> None:
    async with at_desk(tmp_path) as person:
        await until_device(person, "ur", lambda device: device["state"] == "ready")
        config = read_cell_file(person.cell_file)
        with acquire_lease(lease_folder(config), config.robot_named("ur").serial, "a test", DEVICES):
            told = await until_device(person, "ur", lambda device: device["state"] == "unknown")
            assert "another cellcal" in told["message"]
            assert not [each for each in wrong_in(person.session, person.live) if each.source == "ur"]
        await until_device(person, "ur", lambda device: device["state"] == "ready")


async def test_the_others_are_told_while_the_selected_robot_cannot_be_reached(tmp_path: Path) -> None:
    async with at_desk(tmp_path) as person:
        memory = LastHealthyCounts(read_cell_file(person.cell_file).cell.data_dir)
        await select(person, "ur")
        await person.until(lambda _: memory.load_counts("fanuc"))
        await person.door.inject_fault("link_loss_all", device="ur")
        await person.until(lambda session: not session["connection"]["connected"])
        await person.door.inject_fault("battery_loss", axes="all")
        (loss,) = await person.until(lambda session: session["losses"])
        assert loss["robot"] == "fanuc"
        await until_device(person, "fanuc", lambda device: device["state"] == "position_lost")


async def select(person: AtDesk, robot: str) -> None:
    await person.order({"op": "select_robot", "robot": robot})
    await person.until(lambda session: session["robot"] == robot and session["connection"]["connected"])


def device_of(person: AtDesk, name: str) -> dict[str, Any]:
    found = [device for device in person.live.get("devices", []) if device["name"] == name]
    assert len(found) < 2
    return found[0] if found else {"state": "", "role": "", "value": None}


async def until_device(person: AtDesk, name: str, true: Any) -> dict[str, Any]:
    async with asyncio.timeout(stretched_s(90.0)):
        while not true(device_of(person, name)):
            await asyncio.sleep(0.02)
    return device_of(person, name)
