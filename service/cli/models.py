"""``cellcal models``: the nominal robots that ship."""

from typing import Annotated

from cyclopts import Parameter


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
    from rich.table import Table

    from calibration.kinematics import load_model, model_names
    from service.cli.printing import print_json

    names = model_names() if name is None else (name,)
    found = [load_model(each) for each in names]
    if as_json:
        print_json({"models": [_as_object(model) for model in found]})
        return 0
    console = Console()
    if name is None:
        table = Table("model", "robot", "axes")
        for model in found:
            table.add_row(model.name, model.title, str(model.axes))
        console.print(table)
        return 0
    shown = _as_object(found[0])
    table = Table(
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


def _as_object(model: "RobotModel") -> dict[str, "Any"]:
    import numpy as np

    dh = model.dh
    rows = []
    for i in range(model.axes if dh is not None else 0):
        rows.append(
            {
                "theta_deg": float(np.rad2deg(dh.theta_rad[i])),
                "d_mm": float(dh.d_m[i] * 1e3),
                "a_mm": float(dh.a_m[i] * 1e3),
                "alpha_deg": float(np.rad2deg(dh.alpha_rad[i])),
                "beta_deg": float(np.rad2deg(dh.beta_rad[i])),
                "limits_deg": [float(np.rad2deg(model.lower_rad[i])), float(np.rad2deg(model.upper_rad[i]))],
            }
        )
    return {"name": model.name, "title": model.title, "axes": model.axes, "dh": rows}
