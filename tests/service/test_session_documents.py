"""The typed session that passes between the processes has the fields that `/openapi.json` describes."""

from pathlib import Path
from typing import Any, get_type_hints

import pytest

from cellcal.service import session_documents as sent
from cellcal.service.web import response_models as described

SERVICE = Path(sent.__file__).parent
MOST_UNTYPED_LINES = 120
PAIRS = [
    (sent.SessionDocument, described.SessionState),
    (sent.RobotEntry, described.RobotSeen),
    (sent.ConnectionDocument, described.ConnectionSeen),
    (sent.RunDocument, described.RunSeen),
    (sent.PhaseDocument, described.PhaseSeen),
    (sent.RunEventDocument, described.RunEvent),
    (sent.OutcomeDocument, described.OutcomeSeen),
    (sent.SignatureDocument, described.SignedSeen),
    (sent.PlanDocument, described.PlanSeen),
    (sent.PlanPoseDocument, described.SeriesPose),
    (sent.PromptDocument, described.PromptSeen),
    (sent.LossDocument, described.LossSeen),
    (sent.TroubleDocument, described.TroubleSeen),
]


@pytest.mark.parametrize(("document", "model"), PAIRS, ids=lambda kind: kind.__name__)
def test_a_document_has_the_fields_of_its_description(document: Any, model: Any) -> None:
    assert set(get_type_hints(document)) == set(model.model_fields)
    always = {name for name, field in model.model_fields.items() if field.is_required()}
    assert document.__required_keys__ == always


def test_untyped_objects_are_few() -> None:
    lines = [
        line
        for path in SERVICE.rglob("*.py")
        for line in path.read_text(encoding="utf-8").splitlines()
        if "dict[str, Any]" in line
    ]
    assert lines
    assert len(lines) <= MOST_UNTYPED_LINES
