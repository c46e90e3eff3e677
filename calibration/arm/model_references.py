"""Robots by reference: the name of one that ships, a model file, or a description with its base and tip link.

    ur10e                                   a robot that ships
    fanuc_crx10ia?tip=flange                the same, to another frame at the flange that its source names
    arms/my_arm.toml                        a model file
    arms/cell.urdf?base=base_link&tip=tool0 a description in URDF (xacro expanded)

Behind ``@`` stands how the robot is mounted: ``ur10@ceiling``. ``,`` does as well as ``&``.
"""

import hashlib
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from cellcal.calibration.arm.dh_table import DhTable
from cellcal.calibration.arm.model_scale import MODEL_FILE_UNITS, refuse_wrong_units
from cellcal.calibration.arm.mounting import DESCRIPTIONS, FILE_ENDINGS, MOUNTED, gravity_of, split_mounting
from cellcal.calibration.arm.robot_model import RobotModel
from cellcal.calibration.arm.robot_models import known_names
from cellcal.calibration.arm.robot_models.catalogue_index import LINKAGE, catalogue_entries, robot_spelled
from cellcal.calibration.arm.robot_models.model_text import ModelText, read_model_text
from cellcal.calibration.arm.robot_models.shipped_models import model_text
from cellcal.calibration.arm.urdf_reader import UrdfArm, read_urdf
from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.plain_files import read_plain_bytes, text_of
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, inverse_transform
from cellcal.calibration.message import make_message

_MOST_BYTES = 16_000_000
_KEYS = ("base", "tip", "sha256")
_DIGITS = 16  # of the digest: enough to notice any change of a file


@dataclass(frozen=True, slots=True)
class ModelReference:
    """The parts of a reference."""

    where: str  # a name, or the path of a file
    base: str | None = None
    tip: str | None = None
    sha256: str | None = None  # first digits of the file's digest: a changed file is refused
    mounting: str = ""

    @property
    def is_file(self) -> bool:
        """Whether it names a file."""
        return Path(self.where).suffix.lower() in FILE_ENDINGS

    @property
    def file_name(self) -> str:
        """The name of the file, without the folders that only this machine has."""
        return Path(self.where).name

    @property
    def is_description(self) -> bool:
        """Whether it names a description in URDF."""
        return Path(self.where).suffix.lower() in DESCRIPTIONS

    def __str__(self) -> str:
        words = [f"{key}={value}" for key in _KEYS if (value := getattr(self, key)) is not None]
        query = f"?{'&'.join(words)}" if words else ""
        return f"{self.where}{query}{MOUNTED if self.mounting else ''}{self.mounting}"


def parse_reference(text: str) -> ModelReference:
    """Take a reference apart.

    Raises
    ------
    CalibrationError
        It asks for something else than base and tip.
    """
    head, mounting = split_mounting(text)
    where, _, query = head.partition("?")
    words: dict[str, str] = {}
    for word in query.replace(",", "&").split("&"):
        key, _, value = word.partition("=")
        if not word:
            continue
        if key not in _KEYS or not value or key in words:
            raise CalibrationError(
                make_message(
                    "{word!r} in {text!r} is neither base=LINK nor tip=LINK.",
                    word=word,
                    text=text,
                ),
                remedy="Write FILE.urdf?base=LINK&tip=LINK, in quotes on a command line.",
                code="usage",
            )
        words[key] = value
    parts = ModelReference(where, words.get("base"), words.get("tip"), words.get("sha256"), mounting)
    if parts.is_file or where in known_names():
        return parts
    return replace(parts, where=robot_spelled(where) or where)


def is_known_model(reference: str) -> bool:
    """Return whether a robot model can be loaded by this reference."""
    try:
        load_model(reference)
    except CalibrationError:
        return False
    return True


def load_model(reference: str) -> RobotModel:
    """Return a nominal model by reference.

    The model's name is the reference; that of a file gets its whole path and the first digits of its SHA-256, so
    that everything that is kept under this name is refused once the file has changed.

    Raises
    ------
    CalibrationError
        No such robot or file, a file that has changed, or one that describes no arm.
    """
    parts = parse_reference(reference)
    model = _file_model(parts) if parts.is_file else _listed_model(parts, _name_of(parts, reference))
    return replace(model, gravity_in_base=gravity_of(parts.mounting)) if parts.mounting else model


def fixed_reference(reference: str, folder: Path) -> str:
    """Return a reference that means the same from anywhere: a file's whole path and digest; a name as it is.

    Raises
    ------
    CalibrationError
        As `load_model`, for files.
    """
    parts = parse_reference(reference)
    return (
        load_model(str(replace(parts, where=str(folder / parts.where)))).name
        if parts.is_file
        else _name_of(parts, reference)
    )


def _name_of(parts: ModelReference, reference: str) -> str:
    """Return the reference as it is written, but with the catalogue's own name of the robot."""
    return reference if reference.startswith(parts.where) else str(parts)


def maker_of(reference: str) -> str:
    """Return the maker of a robot of the catalogue; empty for a file."""
    name = parse_reference(reference).where
    return next((entry.maker for entry in catalogue_entries() if entry.name == name), "")


def is_linkage(reference: str) -> bool:
    """Return whether a robot of the catalogue has rods that drive an axis."""
    name = parse_reference(reference).where
    return any(entry.name == name and entry.kind == LINKAGE for entry in catalogue_entries())


def model_of_text(name: str, text: ModelText) -> RobotModel:
    """Return the model that a model file holds."""
    fields = dict(text.fields)
    return RobotModel.from_dh(DhTable.from_rows(fields.pop("rows")), name=name, **fields)


@lru_cache(maxsize=512)
def _listed_model(parts: ModelReference, name: str) -> RobotModel:
    # Shipped models never change, so each is read once.
    text = model_text(parts.where)
    if parts.base is None and parts.tip is None:
        return model_of_text(name, text)
    return model_of_text(name, _between(parts, text))


def _between(parts: ModelReference, text: ModelText) -> ModelText:
    """Return a model seen from another base, or up to another frame at the flange."""
    fields: dict[str, Any] = dict(text.fields)
    if parts.base is not None:
        frame_base = inverse_transform(_frame(parts.where, "base", parts.base, text.bases))
        fields["base"] = frame_base @ fields["base"] if "base" in fields else frame_base
    if parts.tip is not None:
        beyond = _frame(parts.where, "tip", parts.tip, text.tips)
        fields["flange"] = fields["flange"] @ beyond if "flange" in fields else beyond
    return ModelText(fields)


def _frame(name: str, what: str, frame: str, frames: dict[str, Array]) -> Array:
    if frame not in frames:
        there = f"It has {', '.join(sorted(frames))}" if frames else "It has none but its own"
        raise CalibrationError(
            make_message("robot {name} has no {what} frame {frame!r}.", name=name, what=what, frame=frame),
            remedy=make_message("{there}; leave ?{what} out for the controller's.", there=there, what=what),
            code="usage",
        )
    return frames[frame]


def _file_model(parts: ModelReference) -> RobotModel:
    if parts.is_description:
        return _description(parts).model
    if parts.base is not None or parts.tip is not None:
        raise CalibrationError(
            make_message(
                "{file_name} is a model file: it states its own base and flange.", file_name=parts.file_name
            ),
            remedy="Leave ?base and ?tip out.",
            code="usage",
        )
    text, name = _text_and_name(parts)
    try:
        model = model_of_text(name, read_model_text(parts.file_name, text))
        refuse_wrong_units(model, MODEL_FILE_UNITS)
        return model
    except (TypeError, ValueError) as broken:
        raise CalibrationError(
            make_message("{path} is no model of a robot: {broken}", path=parts.file_name, broken=broken),
            remedy="calibration/arm/robot_models/README.md shows one.",
        ) from broken


def _description(parts: ModelReference) -> UrdfArm:
    text, name = _text_and_name(parts)
    try:
        return read_urdf(text, tip_link=parts.tip, base_link=parts.base, name=name)
    except CalibrationError as refused:
        raise CalibrationError(
            make_message(
                "{where}: {refused_message}", where=parts.file_name, refused_message=refused.message
            ),
            remedy=refused.remedy,
            code=refused.code,
        ) from refused


def _text_and_name(parts: ModelReference) -> tuple[str, str]:
    """Return a file's text, and the reference that holds its whole path and digest."""
    path = Path(parts.where)
    try:
        content = read_plain_bytes(path, _MOST_BYTES)
        text = text_of(content, path)
    except (OSError, DocumentError) as broken:
        raise CalibrationError(
            make_message(
                "the robot description {path} cannot be read: {broken}",
                path=path,
                broken=getattr(broken, "strerror", None) or broken,
            ),
            remedy=getattr(broken, "remedy", "")
            or "Name a model file (.toml) or a description (.urdf), or a robot of `cellcal models`.",
            code="usage",
        ) from broken
    digest = hashlib.sha256(content).hexdigest()
    if parts.sha256 is not None and not digest.startswith(parts.sha256):
        raise CalibrationError(
            make_message(
                "{name} is another file than the one that was used before: "
                "its SHA-256 begins with {digest}, not {sha256}.",
                name=path.name,
                digest=digest[:_DIGITS],
                sha256=parts.sha256,
            ),
            remedy="Put the old file back; or name the new one, and calibrate again.",
        )
    name = replace(parts, where=str(path.resolve()), sha256=digest[:_DIGITS])
    return text, str(name)
