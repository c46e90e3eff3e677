"""``make soak``: long campaigns, each with its figure on its last line. ``ARGS="turns motor=20"`` chooses some."""

import sys
from collections.abc import Callable

from tests.soak import (
    alignments,
    any_arm,
    calibration_campaign,
    cell_process_kills,
    changed_wires,
    clones,
    cold,
    compensation,
    controllers,
    coverage,
    cramer_rao,
    day,
    durability,
    external_axes,
    fanuc_files,
    few_rows,
    fixtures,
    fleet_page,
    guided_cures,
    idle_connections,
    inputs,
    interrupted_cures,
    interrupted_pendant,
    live,
    losses,
    misfits,
    motion_gate,
    moved_programs,
    outliers,
    pages_link,
    pendant,
    places,
    program_motion,
    program_speed,
    programs,
    screens,
    site,
    starts,
    stories,
    tcp,
    tcp_cell,
    two_tablets,
    ur_fence,
    whole_tests,
)
from tests.soak.campaign_figures import CampaignFigures

CAMPAIGNS: dict[str, tuple[Callable[[int], CampaignFigures], int]] = {
    "turns": (stories.turns, 200),
    "recovery_time": (stories.recovery_time, 4),
    "motor": (stories.motor, 50),
    "all": (stories.all_references, 50),
    "crash": (stories.crash, 40),
    "memory": (stories.memory, 20),
    "swap": (stories.swap, 20),
    "many": (losses.many, 1000),
    "outlier": (losses.outlier, 200),
    "poor": (losses.poor, 1000),
    "pendant": (pendant.pendant, 200),
    "pendant_cut": (interrupted_pendant.interrupted_pendant, 2),
    "abb_cut": (interrupted_pendant.interrupted_abb, 2),
    "cures": (guided_cures.guided_cures, 50),
    "cures_cut": (interrupted_cures.interrupted_cures, 5),
    "exchanged": (losses.exchanged, 300),
    "changed_wires": (changed_wires.changed_wires, 10_000),
    "kill": (durability.kill, 100),
    "cell_process_kills": (cell_process_kills.cell_process_kills, 100),
    "screens": (screens.screens, 50),
    "live": (live.live, 20),
    "inputs": (inputs.inputs, 20_000),
    "fanuc_files": (fanuc_files.fanuc_files, 20_000),
    "rmi_cuts": (controllers.rmi_cuts, 1000),
    "wire_answers": (controllers.wire_answers, 100_000),
    "starts": (starts.starts, 10),
    "matrix": (durability.matrix, 1000),
    "power": (durability.power, 300),
    "corner_story": (durability.corner_story, 3),
    "fence": (ur_fence.fence, 20),
    "fixture": (fixtures.fixture, 500),
    "tool": (fixtures.tool, 500),
    "bases": (fixtures.bases, 200),
    "alignments": (alignments.alignments, 20),
    "tcp": (tcp.tcp, 2000),
    "tcp_cell": (tcp_cell.tcp_cell, 200),
    "calibrations": (calibration_campaign.calibrations, 40),
    "tool_in_calibration": (calibration_campaign.tool_in_calibration, 20),
    "drifts": (calibration_campaign.drifts, 20),
    "clones": (clones.clones, 100),
    "compensation": (compensation.compensation, 1_000_000),
    "places": (places.places, 60),
    "outliers": (outliers.outliers, 400),
    "misfits": (misfits.misfits, misfits.SEEDS),
    "coverage": (coverage.coverage, 2000),
    "gate": (motion_gate.gate, 100_000),
    "few_rows": (few_rows.few_rows, 40),
    "cramer_rao": (cramer_rao.cramer_rao, 1000),
    "moved_fanuc": (moved_programs.moved_fanuc, 10_000),
    "moved_yaskawa": (moved_programs.moved_yaskawa, 10_000),
    "programs_roundtrip": (programs.programs_roundtrip, 10_000),
    "catalogue_arms": (any_arm.catalogue_arms, 382),
    "demo_robots": (any_arm.demo_robots, 4),
    "cold": (cold.cold, 20),
    "two_tablets": (two_tablets.two_tablets, 20),
    "pages_link": (pages_link.pages_link, 20),
    "site": (site.site, 1000),
    "fleet": (fleet_page.fleet, 5),
    "idle_connections": (idle_connections.campaign, 1100),
    "day": (day.day, 1),
    "programs_mutated": (programs.programs_mutated, 100_000),
    "programs_speed": (program_speed.programs_speed, 1_000_000),
    "long_tests": (whole_tests.long_tests, 1),
    "languages": (whole_tests.languages, 1),
}


def main() -> int:
    """Run the campaigns that are named, or all."""
    words = [word.partition("=") for word in sys.argv[1:] or CAMPAIGNS]
    parts = (
        programs.of_one_generator()
        | program_speed.of_one_brand()
        | program_motion.of_one_language()
        | external_axes.of_one_brand()
    )  # which run when they are named
    campaigns = CAMPAIGNS | parts
    unknown = [name for name, _, _ in words if name not in campaigns]
    if unknown:
        sys.stderr.write(f"no campaign {', '.join(unknown)}; there are {', '.join(campaigns)}\n")
        return 2
    ended = []
    for name, _, count in words:
        campaign, full = campaigns[name]
        figures = campaign(int(count) if count else full)
        ended.append(figures.reached)
        sys.stdout.write(f"{'reached' if figures.reached else 'MISSED '} {figures.line}\n")
        sys.stdout.flush()
    return 0 if all(ended) else 3


if __name__ == "__main__":
    sys.exit(main())
