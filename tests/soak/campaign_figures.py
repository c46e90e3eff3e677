"""What a campaign says on its last line, and whether it reached what it must."""

from dataclasses import dataclass


@dataclass(frozen=True)
class CampaignFigures:
    """One line, and the verdict on it."""

    line: str
    reached: bool
