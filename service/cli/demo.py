"""``cellcal demo``: the main job on a fake cell, told in the terminal."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

_SLOWEST, _FASTEST = 1.0, 2000.0  # beyond it a reading takes longer in the world than an arm may stand still


def demo(
    *,
    headless: Annotated[bool, Parameter(negative=())] = False,
    loss: str = "turns",
    seed: int = 1,
    time_factor: float = 600.0,
    keep: Path | None = None,
    as_json: Annotated[bool, Parameter(name="--json", negative=())] = False,
) -> int:
    """Let a fake cell lose its encoders and get its zero back, over real sockets.

    Parameters
    ----------
    headless
        Tell the story in the terminal.
    loss
        turns (battery), motor:J1 … motor:J6 (motor exchanged), all (every reference gone), crash (arm bent),
        memory (the controller forgot), backup (an old one was loaded), swap (another arm).
    seed
        The world's hidden truth; another seed is another robot.
    time_factor
        How much faster than real the world's clock runs.
    keep
        Keep the cell file, the journal and the signed certificate of the recovery in this folder.
    as_json
        Print one JSON object on standard output; the story goes to standard error.
    """
    import asyncio
    import logging
    import tempfile

    from service.cli.printing import print_json
    from service.cli.story import Teller
    from service.demo.story import Plot, fault_of, tell_story
    from service.exit_codes import ExitCode

    logging.getLogger("drivers").setLevel(logging.ERROR)  # that a fake's firmware is unverified is no news
    fault_of(loss)  # a misspelt loss is said before anything starts
    _refuse_impossible(seed, time_factor, keep)
    with tempfile.TemporaryDirectory(prefix="cellcal-demo-") as scratch, Teller() as teller:
        plot = Plot(loss, seed, time_factor, teller.say, teller.on_event)
        report = asyncio.run(tell_story(keep or Path(scratch), plot))
    if as_json:
        print_json(report.as_object())
    else:
        teller.close_with(report)
    if keep is not None:
        _certify(keep)
    return ExitCode.PASS if report.verdict == "PASS" else ExitCode.REFUSED


def _certify(folder: Path) -> None:
    """Write the certificate of the recovery, or the record of its refusal, and say how to check it."""
    from service.cli.certificate import issue_after_run
    from service.cli.printing import EN_ROUTE
    from service.configuration.cell_file import read_cell_file

    issued = issue_after_run(read_cell_file(folder / "cell.toml"), "last")
    if issued is not None:
        check = f"cellcal verify {issued.json_path} --key {issued.key.public}"
        EN_ROUTE.print(f"check it with:\n{check}", markup=False, soft_wrap=True)


def _refuse_impossible(seed: int, time_factor: float, keep: Path | None) -> None:
    from calibration.errors import CellError

    if seed < 0:
        raise CellError(f"--seed {seed} is negative.", remedy="Give 0 or more.", code="usage")
    if not _SLOWEST <= time_factor <= _FASTEST:  # also what is not a number
        raise CellError(
            f"--time-factor {time_factor:g} is not possible.",
            remedy=f"Give {_SLOWEST:g} (real time) to {_FASTEST:g}.",
            code="usage",
        )
    if keep is not None and (keep / "cell.toml").exists():
        raise CellError(
            f"{keep} holds the cell of an earlier demo.", remedy="Give --keep another folder.", code="usage"
        )
