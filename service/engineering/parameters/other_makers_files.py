"""Files of other controllers that people bring as parameters of an arm: what each is, and what can be done."""

import re

from cellcal.calibration.message import make_message
from cellcal.service.engineering.parameters.parameter_set import ParameterSetError

_READ = (
    "Read are the JSON of `cellcal identify`, a parameter set, and a Universal Robots arm's calibration.conf, "
    "port 30001 and ROS kinematics."
)
_MEASURE = (
    "What the arm is on top of its nominal lengths, `cellcal identify` finds from measurements; a description that "
    "already holds it is named as the robot itself: `--robot arm.urdf?tip=LINK`."
)
# How files of controllers begin or what stands in them, what they are, and what else reads them.
_FORMS = (
    (
        re.compile(r"^\s*(MOC|SYS|SIO|EIO|MMC|PROC):CFG_", re.MULTILINE),
        "a configuration of an ABB controller",
        "",
    ),
    (re.compile(r"^\s*(&ACCESS\b|&REL\b|DEFDAT\b)", re.MULTILINE), "a data list of a KUKA controller", ""),
    (
        re.compile(r"^\s*\[\*?\w+\*?\]\$?\w*\s+Storage:|^\s*Field: \$", re.MULTILINE),
        "a variable file of a FANUC controller",
        "Its mastering is read by `cellcal mastering import` and `cellcal mastering record`.",
    ),
    (
        re.compile(r"^(/CRC\b|//?/?(VERSION|SHARE|RC\dG|SYSTEM|HOME|ABSO)\b)", re.MULTILINE),
        "a parameter file of a Yaskawa controller",
        "",
    ),
    (re.compile(r"<robot[\s>]"), "a description (URDF)", ""),
    (re.compile(r"^\s*(theta_deg|dh_source|joints)\s*=", re.MULTILINE), "a model file of a robot", ""),
)


def other_file_error(text: str) -> ParameterSetError:
    """Return the refusal of a text that holds no parameters in a form that is read."""
    for form, what, instead in _FORMS:
        if form.search(text):
            return ParameterSetError(
                make_message("this is {what}: no parameters of an arm are read from it.", what=what),
                remedy=" ".join(filter(None, (instead, _MEASURE))),
            )
    return ParameterSetError("this file holds no parameters of an arm in a form that is read.", remedy=_READ)
