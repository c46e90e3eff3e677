"""``make soak``: long campaigns, each with its figure on its last line. ``ARGS="turns motor=20"`` chooses some."""

import sys

from tests.soak.stories import CAMPAIGNS, Figures


def main() -> int:
    """Run the campaigns that are named, or all."""
    wanted = sys.argv[1:] or list(CAMPAIGNS)
    ended: list[Figures] = []
    for word in wanted:
        name, _, count = word.partition("=")
        campaign, full = CAMPAIGNS[name]
        figures = campaign(int(count) if count else full)
        ended.append(figures)
        sys.stdout.write(f"{'reached ' if figures.reached else 'MISSED  '} {figures.line}\n")
        sys.stdout.flush()
    return 0 if all(figures.reached for figures in ended) else 3


if __name__ == "__main__":
    sys.exit(main())
