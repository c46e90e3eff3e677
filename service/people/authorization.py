"""Whether a session may give an order at present, and in whose name the cell process receives it."""

from collections import OrderedDict
from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.service.cell_process.messages import AnswerPrompt, Order
from cellcal.service.people.authentication import Person
from cellcal.service.people.errors import NotAllowedError, PeopleError, PinAgainError, SecondPersonError
from cellcal.service.people.roles import OrderNeed, Right, Role, need_of
from cellcal.service.session_documents import QuestionContext, QuestionDocument

_MOST_PASSED = 200


@dataclass(frozen=True, slots=True)
class FirstApproval:
    """The first of two approvals: of which question, what it asks word for word, and whose, in which role."""

    prompt_id: str
    question_text: str
    name: str
    role: str = ""


_NONE = FirstApproval("", "", "")
CONSOLE_ROLE = "console"  # of this computer's console while no person is set up


class StaleViewError(PeopleError):
    """The answer is to a question that is not, or no longer, shown."""

    code = "desk.stale"
    status = 409

    def __init__(self) -> None:
        super().__init__("the page was out of date.", remedy="Look at the present step.")


class OrderAuthorizer:
    """The approvals of first persons, and the answers that passed."""

    def __init__(self) -> None:
        self._first = _NONE
        self._passed: OrderedDict[str, str] = OrderedDict()
        self._behind: dict[str, tuple[tuple[str, str], ...]] = {}  # names and roles

    def authorize(
        self, person: Person, press: str, rev: int, order: Order, session: QuestionContext | None
    ) -> str:
        """Return the name in which the order may go to the cell process.

        A yes is judged by the question that is shown: the cell process accepts it only with that ``rev``.

        Raises
        ------
        NotAllowedError, PinAgainError
            The role does not include it; the PIN is wanted first.
        SecondPersonError
            It is noted as the first of two approvals.
        StaleViewError
            The question is not the one that is shown.
        """
        self._behind[person.name] = ((person.name, _effective_role(person)),)
        if not isinstance(order, AnswerPrompt) or not person.has_right(Right.RUN):
            _refuse_order(person, need_of(order, None))
            return person.name
        same = f"{press}|{rev}|{order.prompt_id}|{order.value}|{person.name}"
        if same in self._passed:
            return self._passed[same]  # sent again after a lost link: the cell process knows it, too
        prompt = _answered_prompt(order, rev, session)
        need = need_of(order, prompt)
        _refuse_order(person, need)
        who = person.name if person.may_by_itself(need) else self._approve_second(person, prompt)
        self._passed[same] = who
        while len(self._passed) > _MOST_PASSED:
            self._passed.popitem(last=False)
        return who

    def signers_of(self, who: str) -> list[dict[str, str]]:
        """Return the people behind a name that was granted, each with the role that counted at the last order."""
        return [{"name": name, "role": role} for name, role in self._behind.get(who, ())]

    def is_second_approval(
        self, person: Person, order: Order, rev: int, session: QuestionContext | None
    ) -> bool:
        """Whether an order is the second approval that a first person's waits for: at any screen it counts."""
        if not isinstance(order, AnswerPrompt) or session is None or session["rev"] != rev:
            return False
        prompt, first = session["prompt"], self._first
        return (
            prompt is not None
            and prompt["id"] == order.prompt_id
            and first.question_text == _prompt_text(prompt)
            and first.name != person.name
        )

    @property
    def first_approval(self) -> FirstApproval:
        """The approval that waits for a second person's; an empty one where none does."""
        return self._first

    def _approve_second(self, person: Person, prompt: QuestionDocument) -> str:
        before, question_text = self._first, _prompt_text(prompt)
        if before.question_text == question_text and before.name != person.name:
            self._first = _NONE
            both = f"{before.name} and {person.name}"
            self._behind[both] = ((before.name, before.role), (person.name, _effective_role(person)))
            return both
        self._first = FirstApproval(str(prompt["id"]), question_text, person.name, _effective_role(person))
        raise SecondPersonError(person.name)


def _effective_role(person: Person) -> str:
    return CONSOLE_ROLE if person.alone else person.role.value


def _prompt_text(prompt: QuestionDocument) -> str:
    return str(sorted(prompt.items()))


def _answered_prompt(order: AnswerPrompt, rev: int, session: QuestionContext | None) -> QuestionDocument:
    prompt = None if session is None or session["rev"] != rev else session["prompt"]
    if prompt is None or prompt["id"] != order.prompt_id:
        raise StaleViewError
    return prompt


def _refuse_order(person: Person, need: OrderNeed) -> None:
    if person.locked and need.right not in (Right.SEE, Right.STOP):
        raise PinAgainError("this screen was left alone for a while:")
    if not person.has_right(need.right):
        raise NotAllowedError(person.name, person.role, need.right.value, _roles_with(need.right))
    if need.fresh_pin and not person.fresh_pin:
        raise PinAgainError("for an approval")


def _roles_with(right: Right) -> str:
    if right is Right.CHANGE_LIMITS:
        return "Let an engineer sign in."
    return make_message(
        "Let a {role} or an {higher_role} sign in.",
        role=Role.TECHNICIAN.value,
        higher_role=Role.ENGINEER.value,
    )
