"""What the cell file answers in a recovery that the watch started, and what waits for a person.

With `recover_alone` the cell file approves the plan of a motion, which was checked against limits, shapes and wire;
and it says what an administrator vouched for in it. It has no hands to exchange a battery, no eyes for a robot that
does not know where it is, and it never agrees to a write.
"""

from cellcal.drivers.interfaces import Answer, Instruction, Operator, Question
from cellcal.service.configuration.cell_file import WatchTable

CELL_FILE = "the cell file"  # who answered, in the journal and on the certificate
PLAN, NEWEST, HOOKED = "accept_plan", "saved_counts", "wire_is_hooked"


class AutomaticOperator:
    """Operator. Answers for the cell file until a person had to be asked: who was called may stand in the cell."""

    def __init__(self, watch: WatchTable, people: Operator) -> None:
        confirmed_facts = (
            (PLAN, watch.recover_alone),
            (NEWEST, watch.records_complete),
            (HOOKED, watch.wire_stays_hooked),
        )
        self._answers = frozenset(key for key, is_confirmed in confirmed_facts if is_confirmed)
        self._people = people

    async def confirm(self, instruction: Instruction) -> Answer:
        if instruction.key in self._answers:
            return Answer(CELL_FILE)
        self._answers = frozenset()
        return await self._people.confirm(instruction)

    async def ask_question(self, question: Question) -> Answer:
        self._answers = frozenset()
        return await self._people.ask_question(question)
