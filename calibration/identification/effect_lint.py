"""What few rows say about what the model lacks, for people; and when they cannot say it."""

from collections.abc import Sequence

from cellcal.calibration.identification.effect_mixture import KINDS, UnmodelledEffects
from cellcal.calibration.identification.lints import Lint
from cellcal.calibration.message import join_messages, make_message

_LIKELY = 0.9  # probability
_EXCLUDED = 0.1
_MANY_REJECTED = 0.03  # of the rows: more than good rows that stand out by chance
_CURES = {
    "joints": (
        "the residuals go with what this level of the arm does not have (geometry below level 2, sag, bending of "
        "links, ripple): measure more rows over the whole of every joint, or ask for a higher `--level`."
    ),
    "play": (
        "the residuals look like joints that do not come back to the same angle (play, friction, rounding of the "
        "joints): approach every posture from one side, and let the arm settle."
    ),
    "order": (
        "the residuals go with the order of measuring: device or target moved, was put on again, or arm and floor "
        "warmed up. Come back to a reference posture now and then."
    ),
}
_WHAT = {
    "joints": "sag, bending or ripple",
    "play": "play of the joints",
    "order": "a slow move of device or target",
}


def without_play(notes: Sequence[Lint]) -> list[Lint]:
    """Return notes without that of play: where a joint's direction cannot be seen, it would name another cause."""
    return [note for note in notes if _CURES["play"] not in note.message]


def misfit_notes(misfit: UnmodelledEffects | None, rows: int, rejected: int) -> list[Lint]:
    """Return a note on every kind of effect that is seen, on those that few rows leave open, and on blunders."""
    notes = []
    if rejected > _MANY_REJECTED * rows:
        notes.append(
            Lint(
                "outliers",
                make_message(
                    "{rejected} of {rows} rows stand out and were not fitted: more than chance makes. Look at what "
                    "they share (hidden targets, a joint that moved, a typing error) before the rest is believed.",
                    rejected=rejected,
                    rows=rows,
                ),
            )
        )
    if misfit is None:
        return notes
    chances = dict(zip(KINDS, misfit.probability, strict=True))
    likely_kinds = [kind for kind in KINDS if chances[kind] > _LIKELY]
    notes += [
        Lint(
            "misfit",
            make_message(
                "the model lacks something (probability {chance:.0%}): {cure}",
                chance=chances[kind],
                cure=_CURES[kind],
            ),
        )
        for kind in likely_kinds
    ]
    open_still = [kind for kind in KINDS if _EXCLUDED < chances[kind] <= _LIKELY]
    if open_still:
        listed = join_messages(
            ", ",
            [
                make_message("{effect} (probability {chance:.0%})", effect=_WHAT[kind], chance=chances[kind])
                for kind in open_still
            ],
        )
        notes.append(
            Lint(
                "misfit_open",
                make_message(
                    "{rows} rows are too few to tell whether the model lacks something: {listed}. The stated "
                    "deviations count it; measure more rows.",
                    rows=rows,
                    listed=listed,
                ),
            )
        )
    return notes
