"""Going back to an older version of a robot's parameters, over HTTP: the same bytes, by the person in control."""

from pathlib import Path

from cellcal.service.cell_process.messages import PauseRun
from cellcal.service.engineering.parameters.parameter_set import ParameterSet, ParameterValue, to_text
from cellcal.service.engineering.parameters.parameter_sets import FOLDER, ParameterSets
from cellcal.service.people.session_control import SessionHolder
from tests.service.service_client import open_service_client

SERIAL = "F-104711"
AT = f"/api/parameters/{SERIAL}/rollback"


def two_versions(folder: Path) -> ParameterSets:
    sets = ParameterSets(folder / FOLDER)
    for scale in (1.0, 3.0):
        values = (
            ParameterValue("J1.offset", "rad", 0.1 * scale / 3.0, 1.0e-4),
            ParameterValue("J2.a", "m", -1.7e-4 * scale, 2.0e-5, (1.0 / 3.0,)),
            ParameterValue("J2.sag", "rad/m", 3.1e-3 * scale, None, (0.1 + 0.2, -2.0 / 3.0)),
        )
        sets.save_draft(
            ParameterSet(SERIAL, "fanuc_m6ib", "0" * 64, "2026-01-02T00:00:00Z", "Anna", "a run", values)
        )
    return sets


def values_on_disk(sets: ParameterSets, version: int) -> str:
    text = to_text(sets.load_set(SERIAL, version))
    return text[text.index("[[parameter]]") :]


async def test_the_values_are_those_of_the_old_version_byte_for_byte(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        sets = two_versions(tmp_path)
        first, second = (values_on_disk(sets, version) for version in (1, 2))
        assert first != second
        await service_client.from_console()
        await service_client.sign_in("Emil")
        for to, newest in ((1, 2), (2, 3), (1, 4)):
            answer = await service_client.post_json(AT, {"id": str(newest), "to": to, "newest": newest})
            assert answer.status_code == 200, answer.text
        assert [values_on_disk(sets, version) for version in (3, 4, 5)] == [first, second, first]


async def test_undo_is_refused_without_control(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        sets = two_versions(tmp_path)
        control = service_client.app.state.context.control
        await service_client.from_console()
        other = service_client.authenticator.sessions.open_session("console")
        other = service_client.authenticator.sign_in(other, "Tina", "141421")
        seat = service_client.authenticator.authenticate(other).session_id
        control.take_control(SessionHolder(seat, "Tina"))
        await service_client.sign_in("Emil")
        refused = await service_client.post_json(AT, {"id": "1", "to": 1, "newest": 2})
        ordered = await service_client.send_order(PauseRun(op="pause").model_dump())
        assert (refused.status_code, refused.json()["code"]) == (ordered.status_code, ordered.json()["code"])
        assert refused.status_code in (403, 409)
        assert sets.load_set(SERIAL).version == 2
        control.release_control(seat)
        assert (await service_client.post_json(AT, {"id": "2", "to": 1, "newest": 2})).status_code == 200
