"""What helps where a file holds joints and nothing that a device read."""

from collections.abc import Mapping, Sequence

from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.column_words import (
    ATTITUDE_WORDS,
    DIFFERENCE_WORDS,
    SPREAD_WORDS,
    find_triples,
    key_words,
)
from cellcal.service.engineering.measured.difference_words import sum_remedy


def measurement_remedy(names: Sequence[str], plain: Mapping[str, str], numeric: Sequence[str] | None) -> str:
    """Return what helps where nothing measured is found and the headings tell why; empty where they do not."""
    triples = find_triples(names, plain, "xyz")
    keys = {found: key_words(key) for key, found in triples.items()}
    differences = [found for found, words in keys.items() if words & DIFFERENCE_WORDS]
    others = [
        found
        for found, words in keys.items()
        if not words & (DIFFERENCE_WORDS | SPREAD_WORDS | ATTITUDE_WORDS)
    ]
    if differences and others:
        return sum_remedy(differences[0], others[0])
    if any(plain[name].startswith("o_t_ee") for name in names):
        return (
            "O_T_EE is the pose that the robot calculates from its joints, no measurement: add what a device outside "
            "of it read."
        )
    some = [name for name in names if plain[name].rpartition("_")[2] in ("x", "y", "z")]
    if len({plain[name].rpartition("_")[2] for name in some}) in (1, 2) and not triples:
        return make_message(
            "{names} tell a part of a place: add the columns that are missing; a device that reads one direction "
            'touches a plane, which a layout describes (`--layout`, `kind = "plane"`, see '
            "`deploy/layouts/README.md`).",
            names=", ".join(some),
        )
    if not (names if numeric is None else set(names).intersection(numeric)):
        return (
            "It holds joints alone: every row needs what a device read. If that is another file, name it first and "
            "this one by `--joints`. Postures that touch one pin with one tip are "
            'described by a layout (`--layout`, `kind = "pin"`, see `deploy/layouts/README.md`).'
        )
    return ""
