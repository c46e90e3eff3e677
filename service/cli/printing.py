"""Results on standard output, everything else on standard error."""

import json
import sys
from typing import Any

from rich.console import Console

EN_ROUTE = Console(stderr=True, highlight=False)


def print_json(document: dict[str, Any]) -> None:
    """Print one JSON object on standard output; NaN and infinity are refused."""
    sys.stdout.write(json.dumps(document, allow_nan=False, ensure_ascii=False) + "\n")
    sys.stdout.flush()
