"""The numbers of a robot that ships, by its name."""

from pathlib import Path

from cellcal.calibration.arm.robot_models import model_names
from cellcal.calibration.arm.robot_models.catalogue_index import (
    catalogue_robot,
    nearest_names,
    usable_names,
    withheld_reason,
)
from cellcal.calibration.arm.robot_models.model_text import ModelText, model_of_data, read_model_text
from cellcal.calibration.arm.robot_models.other_kinds import other_kind
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.message import make_message

_FOLDER = Path(__file__).parent


def model_text(name: str) -> ModelText:
    """Return what is known of one robot that ships.

    Raises
    ------
    CalibrationError
        No such robot, or one that the catalogue withholds.
    """
    if name in model_names():
        text = read_plain_text(_FOLDER / f"{name}.toml")
        catalogue_model = read_model_text(name, text)
        if name not in usable_names():
            return catalogue_model
        listed = model_of_data(name, catalogue_robot(name))
        return ModelText(catalogue_model.fields, listed.tips, listed.bases)
    if name in usable_names():
        return model_of_data(name, catalogue_robot(name))
    reason = withheld_reason(name)
    if reason is not None:
        raise CalibrationError(
            make_message(
                "robot {name} is in the catalogue without its numbers: {reason}", name=name, reason=reason
            ),
            remedy="Write a model file of your own, or read the maker's description (URDF).",
            code="usage",
        )
    other = other_kind(name)
    if other is not None:
        raise CalibrationError(
            make_message("{name} {reason}", name=name, reason=other.reason), remedy=other.remedy, code="usage"
        )
    near = nearest_names(name)
    there = (
        make_message("Did you mean {near}?", near=near[0])
        if near
        else make_message("Known: {names} and many more.", names=", ".join(model_names()))
    )
    raise CalibrationError(
        make_message("there is no robot model {name!r}.", name=name),
        remedy=make_message(
            "{there} `cellcal models WORDS` finds them; "
            "a model file (.toml) or a description (.urdf?tip=LINK) does as well.",
            there=there,
        ),
        code="usage",
    )
