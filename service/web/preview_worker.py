"""The process that plans: what a run would do and bring, computed beside the web's own process."""

import sys
from collections.abc import Callable, Mapping
from typing import Any

from pydantic_core import to_jsonable_python

from cellcal.procedures.catalogue import definition_named
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.parameters.simulated_cells import refuse_paths
from cellcal.service.review.compute_worker import answer_questions
from cellcal.service.runs.run_preview import dry_run
from cellcal.service.unexpected_errors import run_guarded

MODULE = "cellcal.service.web.preview_worker"
DRY_RUN = "dry run"


def make_handlers(config: CellConfig) -> Mapping[str, Callable[..., Any]]:
    """Return what can be asked, by name."""

    def preview(procedure: str, robot: str | None, settings: dict[str, Any]) -> Any:
        refuse_paths(definition_named(procedure).spec_type, settings)
        return to_jsonable_python(dry_run(config, procedure, settings, robot))

    return {DRY_RUN: preview}


def main() -> None:
    """Answer questions about runs to come."""
    answer_questions(make_handlers)


if __name__ == "__main__":
    sys.exit(run_guarded(main))
