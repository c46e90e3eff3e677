"""The check that a controller took a tool or user frame as it was sent."""

import numpy as np

from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError

_SAME_M, _SAME_RAD = 2e-6, 2e-5  # controllers write and read to 0.001 mm and 0.001 deg


def frames_agree(found: Pose, sent: Pose, *, within_m: float, within_rad: float) -> bool:
    """Return whether two poses agree, each coordinate [m] and each element of the rotation matrix."""
    near = np.allclose(found.position_m, sent.position_m, rtol=0, atol=within_m)
    return near and bool(
        np.allclose(found.rotation_matrix(), sent.rotation_matrix(), rtol=0, atol=within_rad)
    )


def require_frame_as_sent(device: str, number: int, found: Pose, sent: Pose) -> None:
    """Raise RefusedError where the frame that was read back is another one than was sent."""
    if not frames_agree(found, sent, within_m=_SAME_M, within_rad=_SAME_RAD):
        raise RefusedError(
            device,
            make_message("frame {number} was not written as sent.", number=number),
            remedy="Check that the frame is not locked on the controller, then write again.",
        )
