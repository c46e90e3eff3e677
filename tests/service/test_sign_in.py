"""Signing in: tokens and challenges once, PINs rarely, sessions for a while; and what an approval takes."""

from pathlib import Path
from typing import Any

import pytest

from cellcal.service.people.errors import NotAllowedError, NotSignedInError, WrongSecretError
from cellcal.service.people.roles import Role
from tests.service.service_client import (
    PINS,
    ServiceClock,
    TabletKey,
    another_browser,
    encode_base64url,
    open_service_client,
)

# what people try to put into names, notes and settings
XSS = [
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "<svg/onload=alert(1)>",
    "javascript:alert(1)",
    "{{constructor.constructor('alert(1)')()}}",
    "';alert(1)//",
    "</title><script>alert(1)</script>",
    "&lt;script&gt;alert(1)&lt;/script&gt;",
]


async def test_before_people_are_set_up_the_console_is_the_technician(tmp_path: Path) -> None:
    async with open_service_client(tmp_path, people=False) as service_client:
        assert (await service_client.client.get("/api/session")).status_code == 401
        await service_client.from_console()
        person_answer = (await service_client.client.get("/api/session")).json()["person"]
        assert (person_answer["name"], person_answer["role"]) == ("local technician", "technician")
        assert (await service_client.send_order({"op": "pause"})).json()["code"] == "desk.gone"


async def test_the_console_s_address_works_once_and_a_new_one_is_shown(tmp_path: Path) -> None:
    shown: list[str] = []
    async with open_service_client(tmp_path, people=False) as service_client:
        service_client.authenticator.on_console_token = shown.append
        token = service_client.authenticator.console_token()
        first = await service_client.client.get("/api/sign-in/console", params={"token": token})
        assert (first.status_code, first.headers["location"]) == (303, "/")
        async with another_browser(service_client.app) as other:
            for used in (token, "", "x" * 43):
                answer = await other.get("/api/sign-in/console", params={"token": used})
                assert answer.status_code in (403, 422)
                assert not other.cookies
            assert len(shown) == 1
            assert (await other.get("/api/sign-in/console", params={"token": shown[0]})).status_code == 303


async def test_once_people_are_set_up_the_console_alone_looks_on(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        await service_client.from_console()
        assert (await service_client.client.get("/api/session")).json()["person"]["role"] == "viewer"
        assert (await service_client.client.get("/api/sign-in")).json()["wanted"] == "person"
        assert (await service_client.send_order({"op": "pause"})).json()["code"] == "people.role"
        assert (await service_client.send_order({"op": "stop"})).json()["code"] == "desk.stop_unconfirmed"
        assert (await service_client.sign_in("Tom")).status_code == 200
        assert (await service_client.client.get("/api/sign-in")).json()["wanted"] == "nothing"
        assert (await service_client.send_order({"op": "pause"})).json()["code"] == "desk.gone"


async def test_setting_people_up_ends_the_rights_of_the_console(tmp_path: Path) -> None:
    async with open_service_client(tmp_path, people=False) as service_client:
        await service_client.from_console()
        assert (await service_client.send_order({"op": "pause"})).json()["code"] == "desk.gone"
        service_client.authenticator.accounts.add_person("Ada", Role.ADMIN, "kept", "test")
        assert (await service_client.send_order({"op": "pause"}, press="2")).json()["code"] == "people.role"


async def test_signing_in_changes_the_token_so_that_one_known_before_is_worth_nothing(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        await service_client.from_console()
        before = dict(service_client.client.cookies)
        await service_client.sign_in("Tom")
        assert dict(service_client.client.cookies) != before
        async with another_browser(service_client.app) as thief:
            thief.cookies.update(before)
            assert (await thief.get("/api/session")).status_code == 401
        signed_in = dict(service_client.client.cookies)
        assert (await service_client.post_json("/api/sign-in/leave", {})).status_code == 200
        assert (await service_client.client.get("/api/session")).json()["person"]["role"] == "viewer"
        async with another_browser(service_client.app) as thief:
            thief.cookies.update(signed_in)
            assert (await thief.get("/api/session")).status_code == 401


async def test_a_pin_is_worth_nothing_on_a_device_that_is_not_enrolled(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        assert (await service_client.sign_in("Tom")).status_code == 401
        assert not service_client.client.cookies


# devices


async def test_an_enrolled_device_comes_in_and_a_revoked_one_is_out_at_once(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        tablet = TabletKey()
        await tablet.enrol_device(service_client)
        assert (await tablet.come_in(service_client)).status_code == 200
        person = (await service_client.client.get("/api/session")).json()["person"]
        assert (person["name"], person["role"]) == ("tablet 3", "viewer")
        await service_client.sign_in("Emil")
        assert (await service_client.send_order({"op": "pause"})).json()["code"] == "desk.gone"
        service_client.authenticator.accounts.revoke_device(tablet.id, "test")
        assert (await service_client.send_order({"op": "stop"}, press="2")).status_code == 401
        assert (await tablet.come_in(service_client)).status_code == 403


async def test_an_enrolment_is_used_once_and_within_ten_minutes(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        token = service_client.authenticator.accounts.create_enrolment("tablet 3", "test")
        enrolment = {"token": token, "public_key": TabletKey().spki}
        assert (await service_client.post_json("/api/sign-in/devices", enrolment)).status_code == 200
        assert (await service_client.post_json("/api/sign-in/devices", enrolment)).status_code == 403
        late = service_client.authenticator.accounts.create_enrolment("tablet 4", "test")
        service_client.clock.pass_by(601.0)
        assert (
            await service_client.post_json("/api/sign-in/devices", enrolment | {"token": late})
        ).status_code == 403
        assert [device.name for device in service_client.authenticator.accounts.list_devices()] == [
            "tablet 3"
        ]


async def test_a_proof_counts_once_for_this_address_and_for_a_minute(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        tablet, stranger = TabletKey(), TabletKey()
        await tablet.enrol_device(service_client)

        async def proof(**other: Any) -> int:
            challenge = service_client.authenticator.create_challenge()
            service_client.clock.pass_by(other.pop("late_s", 0.0))
            signature = other.pop("by", tablet).sign_challenge(
                challenge, other.pop("origin", "http://127.0.0.1")
            )
            proof_body = {"device": tablet.id, "challenge": challenge, "signature": signature} | other
            answer = await service_client.post_json("/api/sign-in/device", proof_body)
            status = answer.status_code
            if status == 200:  # what is wanted next, which a page need not ask for
                challenge_answer = (await service_client.client.get("/api/sign-in")).json()
                assert answer.json() == {"ok": True, **challenge_answer}
                assert challenge_answer["wanted"] == "person"
            again = (await service_client.post_json("/api/sign-in/device", proof_body)).status_code
            assert again in (403, 422)
            return status

        assert await proof() == 200
        assert await proof(by=stranger) == 403
        assert await proof(late_s=61.0) == 403
        assert await proof(origin="https://evil.example") == 403
        assert await proof(challenge="x" * 43) == 403
        assert await proof(device="unknown") == 403
        for signature in (
            "",
            "x",
            encode_base64url(bytes(64)),
            encode_base64url(bytes(63)),
            encode_base64url(b"\xff" * 64),
            "é" * 10,
        ):
            assert await proof(signature=signature) in (403, 422)


@pytest.mark.parametrize("curve", ["P-384", "ed25519", "rsa", "text"])
async def test_only_a_key_on_p_256_is_enrolled(tmp_path: Path, curve: str) -> None:
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric import ec, ed25519, rsa

    makers: dict[str, Any] = {
        "P-384": lambda: ec.generate_private_key(ec.SECP384R1()),
        "ed25519": ed25519.Ed25519PrivateKey.generate,
        "rsa": lambda: rsa.generate_private_key(65537, 1024),
    }
    raw = b"no key"
    if curve in makers:
        form = serialization.PublicFormat.SubjectPublicKeyInfo
        raw = makers[curve]().public_key().public_bytes(serialization.Encoding.DER, form)
    async with open_service_client(tmp_path) as service_client:
        token = service_client.authenticator.accounts.create_enrolment("tablet 3", "test")
        assert (
            await service_client.post_json(
                "/api/sign-in/devices", {"token": token, "public_key": encode_base64url(raw)}
            )
        ).status_code == 403
        assert service_client.authenticator.accounts.list_devices() == ()


# time


async def test_a_screen_left_alone_shows_and_stops_and_wants_the_pin_for_the_rest(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        await service_client.from_console()
        await service_client.sign_in("Tom")
        for _ in range(3):  # a person at work is not locked out
            service_client.clock.pass_by(290.0)
            assert (await service_client.send_order({"op": "pause"})).json()["code"] == "desk.gone"
        service_client.clock.pass_by(301.0)
        person_answer = (await service_client.client.get("/api/session")).json()["person"]
        assert (person_answer["name"], person_answer["role"], person_answer["locked"]) == (
            "Tom",
            "viewer",
            True,
        )
        for _ in range(2):  # asking does not unlock
            assert (await service_client.send_order({"op": "go_on"})).json()["code"] == "people.pin"
        assert (await service_client.send_order({"op": "stop"})).json()["code"] == "desk.stop_unconfirmed"
        assert (await service_client.client.get("/api/sign-in")).json()["wanted"] == "pin"
        assert (
            await service_client.post_json("/api/sign-in/confirm", {"secret": "000000"})
        ).status_code == 403
        assert (
            await service_client.post_json("/api/sign-in/confirm", {"secret": PINS["Tina"]})
        ).status_code == 403
        assert (
            await service_client.post_json("/api/sign-in/confirm", {"secret": PINS["Tom"]})
        ).status_code == 200
        assert (await service_client.send_order({"op": "go_on"})).json()["code"] == "desk.gone"


async def test_after_twelve_hours_a_session_is_over_however_much_it_was_used(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        await service_client.from_console()
        await service_client.sign_in("Tom")
        for _ in range(12 * 15):
            service_client.clock.pass_by(239.0)
            await service_client.send_order({"op": "pause"})
        assert (await service_client.client.get("/api/session")).status_code == 200
        service_client.clock.pass_by(12 * 15 + 1.0)
        assert (await service_client.client.get("/api/session")).status_code == 401


async def test_leaving_does_not_make_a_session_longer(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        await service_client.from_console()
        for _ in range(4):
            service_client.clock.pass_by(3 * 3600.0 + 1.0)
            answer = await service_client.post_json("/api/sign-in/leave", {})
        assert answer.status_code == 401


async def test_a_new_pin_or_role_ends_what_was_signed_in_with_the_old(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        await service_client.from_console()
        await service_client.sign_in("Tom")
        service_client.authenticator.accounts.reset_person("Tom", Role.VIEWER, "kept", "test")
        assert (await service_client.send_order({"op": "pause"})).json()["code"] == "people.role"
        await service_client.sign_in("Tina")
        service_client.authenticator.accounts.remove_person("Tina", "test")
        assert (await service_client.send_order({"op": "pause"}, press="2")).json()["code"] == "people.role"
        assert (await service_client.sign_in("Tina")).status_code == 403


async def test_a_restart_ends_sessions_and_keeps_accounts(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        await service_client.from_console()
        await service_client.sign_in("Tom")
        tablet = TabletKey()
        await tablet.enrol_device(service_client)
        old_cookies = dict(service_client.client.cookies)
    async with open_service_client(tmp_path / "again", people=False) as again:
        again.authenticator.data_dir = service_client.authenticator.data_dir
        again.authenticator.accounts.path = service_client.authenticator.accounts.path
        again.client.cookies.update(old_cookies)
        assert (await again.client.get("/api/session")).status_code == 401
        assert (await tablet.come_in(again)).status_code == 200
        assert (await again.sign_in("Tom")).status_code == 200


# guesses


async def test_five_wrong_pins_then_one_an_hour_also_for_the_right_one(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        await service_client.from_console()
        wrong = [(await service_client.sign_in("Tom", f"00000{n}")).status_code for n in range(6)]
        assert wrong == [403] * 5 + [429]
        assert (await service_client.sign_in("Tom")).json()["code"] == "people.wait"
        assert (await service_client.client.get("/api/session")).status_code == 200
        assert (await service_client.send_order({"op": "stop"})).json()["code"] == "desk.stop_unconfirmed"
        assert (await service_client.sign_in("Tina")).status_code == 200  # others are not locked out
        service_client.clock.pass_by(3601.0)
        assert (await service_client.sign_in("Tom", "000009")).status_code == 403
        assert (await service_client.sign_in("Tom")).status_code == 429
        service_client.clock.pass_by(3601.0)
        assert (await service_client.sign_in("Tom")).status_code == 200
        assert (await service_client.sign_in("Tom", "000000")).status_code == 403  # five anew
        assert (await service_client.sign_in("Tom")).status_code == 200


async def test_another_device_gives_no_more_guesses(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        await service_client.from_console()
        for n in range(5):
            await service_client.sign_in("Tom", f"00000{n}")
        tablet = TabletKey()
        await tablet.enrol_device(service_client)
        await tablet.come_in(service_client)
        assert (await service_client.sign_in("Tom")).status_code == 429


async def test_sign_in_errors_do_not_reveal_what_was_wrong(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        await service_client.from_console()
        answers = [
            await service_client.sign_in("Tom", "000000"),
            await service_client.sign_in("Unknown", "000000"),
        ]
        assert answers[0].json() == answers[1].json()
        assert [a.status_code for a in answers] == [403, 403]


# approvals


async def test_moves_are_approved_with_the_pin_just_entered(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        await service_client.from_console()
        await service_client.sign_in("Tom")
        assert (await service_client.send_order(service_client.show_question("accept_plan"))).json()[
            "code"
        ] == "desk.gone"
        service_client.clock.pass_by(121.0)
        assert (
            await service_client.send_order(service_client.show_question("wire_is_hooked"), press="2")
        ).json()["code"] == "desk.gone"
        answer = await service_client.send_order(service_client.show_question("approve_move"), press="3")
        assert (answer.status_code, answer.json()["code"]) == (401, "people.pin")
        await service_client.post_json("/api/sign-in/confirm", {"secret": PINS["Tom"]})
        assert (
            await service_client.send_order(service_client.show_question("approve_move"), press="4")
        ).json()["code"] == "desk.gone"


@pytest.mark.parametrize("key", ["accept_mastering", "accept_tool", "accept_something_new"])
async def test_a_controller_is_written_by_an_engineer_or_by_two(tmp_path: Path, key: str) -> None:
    async with open_service_client(tmp_path) as service_client:
        await service_client.from_console()
        await service_client.sign_in("Emil")
        assert (await service_client.send_order(service_client.show_question(key))).json()[
            "code"
        ] == "desk.gone"
        await service_client.sign_in("Tom")
        for press in ("2", "3"):  # one person twice is one person
            answer = await service_client.send_order(service_client.show_question(key), press=press)
            assert (answer.status_code, answer.json()["code"]) == (409, "people.second_person")
        await service_client.sign_in("Tina")
        assert (await service_client.send_order(service_client.show_question(key), press="4")).json()[
            "code"
        ] == "desk.gone"


async def test_a_first_approval_is_for_that_question_only(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        await service_client.from_console()
        await service_client.sign_in("Tom")
        await service_client.send_order(service_client.show_question("accept_tool"))
        await service_client.sign_in("Tina")
        other = await service_client.send_order(
            service_client.show_question("accept_tool", rev=2, prompt_id="run:2"), rev=2, press="2"
        )
        assert other.json()["code"] == "people.second_person"


async def test_a_yes_to_what_is_not_shown_is_not_passed_on(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        await service_client.from_console()
        await service_client.sign_in("Tom")
        yes = service_client.show_question("wire_is_hooked", rev=7)
        for order, rev in ((yes, 8), (yes | {"prompt_id": "run:2"}, 7)):
            answer = await service_client.send_order(order, rev=rev)
            assert (answer.status_code, answer.json()["code"]) == (409, "desk.stale")
        assert (await service_client.send_order(yes, rev=7)).json()["code"] == "desk.gone"
        service_client.show_question("accept_mastering", rev=9, prompt_id="run:3")
        assert (await service_client.send_order(yes, rev=7)).json()[
            "code"
        ] == "desk.gone"  # the same press, sent again
        assert (await service_client.send_order(yes, rev=7, press="other")).json()["code"] == "desk.stale"


def test_an_order_carries_the_name_of_its_sender() -> None:
    from cellcal.service.cell_process.messages import AnswerPrompt, PauseRun
    from cellcal.service.people.authentication import LOCAL_PERSON, Person
    from cellcal.service.people.authorization import OrderAuthorizer
    from cellcal.service.people.errors import SecondPersonError

    session = {"rev": 1, "prompt": {"id": "a", "key": "accept_mastering"}}
    yes = AnswerPrompt(op="answer", prompt_id="a")
    tom, tina = (Person(name, Role.TECHNICIAN, fresh_pin=True) for name in ("Tom", "Tina"))
    permits = OrderAuthorizer()
    assert permits.authorize(tom, "1", 1, PauseRun(op="pause"), session) == "Tom"
    with pytest.raises(SecondPersonError):
        permits.authorize(tom, "2", 1, yes, session)
    assert permits.authorize(tina, "3", 1, yes, session) == "Tom and Tina"
    assert permits.authorize(LOCAL_PERSON, "4", 1, yes, session) == "local technician"
    with pytest.raises(NotAllowedError):
        permits.authorize(Person("Ada", Role.ADMIN, fresh_pin=True), "5", 1, yes, session)


# what people write


@pytest.mark.parametrize("text", XSS)
async def test_what_people_write_comes_back_as_json_only(tmp_path: Path, text: str) -> None:
    async with open_service_client(tmp_path) as service_client:
        service_client.authenticator.accounts.add_person(text, Role.TECHNICIAN, "kept", "test")
        await service_client.from_console()
        dry = {"procedure": text, "settings": {text: text}}
        for answer in (
            await service_client.client.get("/api/sign-in/people"),
            await service_client.sign_in(text, text),
            await service_client.post_json("/api/dry-runs", dry),
            await service_client.post_json("/api/dry-runs", dry | {"procedure": "mastering_record"}),
            await service_client.send_order({"op": text}),
            await service_client.client.get("/api/trend", params={"procedure": text, "robot_serial": text}),
            await service_client.client.get("/api/runs/" + text.replace("/", "%2f")),
        ):
            assert answer.headers["content-type"] == "application/json"
            assert answer.headers["x-content-type-options"] == "nosniff"
            assert answer.status_code < 500
            answer.json()


async def test_open_access_is_for_demos(tmp_path: Path) -> None:
    async with open_service_client(tmp_path, people=False, open_access=True) as service_client:
        assert (await service_client.client.get("/api/session")).json()["person"][
            "name"
        ] == "local technician"
        other_page = await service_client.client.get(
            "/api/session", headers={"origin": "http://evil.example"}
        )
        assert other_page.status_code == 403


def test_an_unknown_device_is_reported_as_unknown(tmp_path: Path) -> None:
    from cellcal.service.people.authentication import Authenticator

    authenticator = Authenticator(tmp_path, clock=ServiceClock(), wall_clock=ServiceClock())
    for token in (None, "", "x", "x" * 5000):
        with pytest.raises(NotSignedInError):
            authenticator.authenticate(token)
    with pytest.raises(WrongSecretError):
        authenticator.from_console("anything")
