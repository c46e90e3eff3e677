"""Damaged inputs of every kind: no trace, none slower than 2 s, none past 512 MB."""

import resource
import sys
import tempfile
import time
import traceback
from dataclasses import dataclass, field
from pathlib import Path

from cellcal.calibration.errors import CellError
from tests.soak.campaign_figures import CampaignFigures
from tests.soak.input_mutations import mutated_input
from tests.soak.input_readers import InputReader, file_readers, place_file

MOST_S, MOST_BYTES = 2.0, 512 << 20


@dataclass
class InputFindings:
    """What a campaign saw."""

    cases: int = 0
    read: int = 0
    traces: dict[str, str] = field(default_factory=dict)  # by where they were raised
    slow: list[str] = field(default_factory=list)

    @property
    def list_flaws(self) -> list[str]:
        """Every flaw in words."""
        return [*self.traces.values(), *self.slow]


def try_input(reader: InputReader, scratch: Path, seed: int, found: InputFindings) -> None:
    """Give one damaged example to an input, and note what should not be."""
    example = reader.examples[seed % len(reader.examples)]
    with place_file(reader, scratch, mutated_input(example, seed)) as path:
        began_s = time.process_time()
        try:
            reader.read(path)
            found.read += 1
        except (CellError, OSError):
            pass
        except BaseException as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{reader.name}: {type(error).__name__} at {last.filename}:{last.lineno}"
            found.traces.setdefault(where, f"{where} ({str(error)[:80]}), seed {seed}")
        took_s = time.process_time() - began_s
    found.cases += 1
    if took_s > MOST_S:
        found.slow.append(f"{reader.name}: seed {seed} took {took_s:.1f} s")


def inputs(count: int, names: tuple[str, ...] = ()) -> CampaignFigures:
    """Try ``count`` damaged examples of every input."""
    found = InputFindings()
    with tempfile.TemporaryDirectory(prefix="cellcal-inputs-") as folder:
        scratch = Path(folder)
        doors = [reader for reader in file_readers(scratch) if not names or reader.name in names]
        before = _peak_bytes()
        for reader in doors:
            for seed in range(count):
                try_input(reader, scratch, seed, found)
            print(f"{reader.name}: {len(found.list_flaws)} flaws so far", file=sys.stderr)
    grown = _peak_bytes() - before
    for flaw in found.list_flaws:
        print(flaw)
    line = (
        f"{found.cases} damaged inputs at {len(doors)} doors, {found.read} read: {len(found.traces)} traces, "
        f"{len(found.slow)} over {MOST_S:g} s, memory grew by {grown >> 20} MB"
    )
    return CampaignFigures(line, not found.list_flaws and grown < MOST_BYTES)


def _peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
