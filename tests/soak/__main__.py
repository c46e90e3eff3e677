"""``make soak``: long campaigns, each with its figure on its last line. ``ARGS="turns motor=20"`` chooses some."""

import sys
from collections.abc import Callable

from tests.soak import compensation, durability, losses, stories, ur_fence
from tests.soak.figures import Figures

CAMPAIGNS: dict[str, tuple[Callable[[int], Figures], int]] = {
    "turns": (stories.turns, 200),
    "motor": (stories.motor, 50),
    "all": (stories.all_references, 50),
    "crash": (stories.crash, 40),
    "many": (losses.many, 1000),
    "outlier": (losses.outlier, 200),
    "poor": (losses.poor, 200),
    "kill": (durability.kill, 100),
    "matrix": (durability.matrix, 1000),
    "power": (durability.power, 300),
    "fence": (ur_fence.fence, 20),
    "compensation": (compensation.compensation, 1_000_000),
}


def main() -> int:
    """Run the campaigns that are named, or all."""
    words = [word.partition("=") for word in sys.argv[1:] or CAMPAIGNS]
    unknown = [name for name, _, _ in words if name not in CAMPAIGNS]
    if unknown:
        sys.stderr.write(f"no campaign {', '.join(unknown)}; there are {', '.join(CAMPAIGNS)}\n")
        return 2
    ended = []
    for name, _, count in words:
        campaign, full = CAMPAIGNS[name]
        figures = campaign(int(count) if count else full)
        ended.append(figures.reached)
        sys.stdout.write(f"{'reached' if figures.reached else 'MISSED '} {figures.line}\n")
        sys.stdout.flush()
    return 0 if all(ended) else 3


if __name__ == "__main__":
    sys.exit(main())
