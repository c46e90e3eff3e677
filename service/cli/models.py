"""``cellcal models``: the nominal robots that ship."""

from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

if TYPE_CHECKING:
    from cellcal.calibration.arm.kinematics import DhTable, RobotModel


def models(name: str | None = None, /, *, as_json: Annotated[bool, Parameter(name="--json")] = False) -> int:
    """List the nominal robot models that ship, or show the parameters of one.

    Parameters
    ----------
    name
        Show this model's DH table, limits and sources.
    as_json
        Print one JSON object on standard output.
    """
    from rich.console import Console

    from cellcal.calibration.arm.kinematics import load_model, model_names
    from cellcal.service.cli.printing import PlainTable, print_json

    names = model_names() if name is None else (name,)
    found = [load_model(each) for each in names]
    if as_json:
        print_json({"models": [_as_object(model) for model in found]})
        return 0
    console = Console(emoji=False)
    if name is None:
        table = PlainTable("model", "robot", "axes")
        for model in found:
            table.add_row(model.name, model.title, str(model.axis_count))
        console.print(table)
        return 0
    shown = _as_object(found[0])
    table = PlainTable(
        "row",
        "theta (deg)",
        "d (mm)",
        "a (mm)",
        "alpha (deg)",
        "beta (deg)",
        "limits (deg)",
        title=found[0].title,
    )
    for i, row in enumerate(shown["dh"], start=1):
        low, high = row["limits_deg"]
        numbers = [f"{row[key]:.4f}" for key in ("theta_deg", "d_mm", "a_mm", "alpha_deg", "beta_deg")]
        table.add_row(f"J{i}", *numbers, f"{low:g} … {high:g}")
    console.print(table)
    return 0


def _as_object(model: "RobotModel") -> dict[str, Any]:
    rows = [] if model.dh is None else [_row(model, model.dh, i) for i in range(model.axis_count)]
    return {"name": model.name, "title": model.title, "axes": model.axis_count, "dh": rows}


def _row(model: "RobotModel", dh: "DhTable", i: int) -> dict[str, Any]:
    from math import degrees

    return {
        "theta_deg": degrees(dh.theta_rad[i]),
        "d_mm": float(dh.d_m[i]) * 1e3,
        "a_mm": float(dh.a_m[i]) * 1e3,
        "alpha_deg": degrees(dh.alpha_rad[i]),
        "beta_deg": degrees(dh.beta_rad[i]),
        "limits_deg": [degrees(model.lower_rad[i]), degrees(model.upper_rad[i])],
    }
