"""The tables behind the catalogue, and their own arithmetic: no line of it is the product's."""

import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

FOLDER = Path(__file__).parents[3] / "deploy" / "robot_catalogue"


@cache
def tables() -> dict[str, dict[str, Any]]:
    """Return every table by its id, with its maker in it."""
    found = {}
    for path in sorted((FOLDER / "tables").glob("*.toml")):
        document = tomllib.loads(path.read_text())
        found |= {robot["id"]: {**robot, "maker": document["maker"]} for robot in document["robot"]}
    return found


@cache
def withheld() -> dict[str, dict[str, Any]]:
    """Return what is said of robots that do not ship, by id."""
    return {entry["id"]: entry for entry in tomllib.loads((FOLDER / "withheld.toml").read_text())["robot"]}


def flange_by_joints(table: dict[str, Any], joints: np.ndarray) -> np.ndarray:
    """Return (N, 4, 4): the tip in the controller's base, joint by joint as the description says it."""
    angles = chain_joints(table, joints)
    here = np.broadcast_to(np.linalg.inv(place(table.get("controller_base", {}))), (len(joints), 4, 4))
    for joint, values in zip(table["joint"], angles.T, strict=True):
        here = here @ place(joint) @ moved(joint, values)
    return here @ place(table["tip"])


def flange_by_rows(table: dict[str, Any], joints: np.ndarray) -> np.ndarray:
    """Return the same from the table's DH rows: Rot(z, theta) Trans(z, d) Trans(x, a) Rot(x, alpha)."""
    angles = chain_joints(table, joints)
    signs = table.get("dh_sign", [1] * len(table["dh"]))
    base = np.linalg.inv(place(table.get("controller_base", {}))) @ place(table.get("dh_base", {}))
    here = np.broadcast_to(base, (len(joints), 4, 4))
    for i, (theta, d, a, alpha) in enumerate(table["dh"]):
        step = signs[i] * angles[:, i]
        slides = table["joint"][i]["type"] == "prismatic"
        turn = np.radians(theta) + (0.0 if slides else step)
        height = d / 1e3 + (step if slides else 0.0)
        row = np.zeros((len(joints), 4, 4))
        row[:, 3, 3] = 1.0
        ca, sa = np.cos(np.radians(alpha)), np.sin(np.radians(alpha))
        row[:, 0, :3] = np.stack([np.cos(turn), -np.sin(turn) * ca, np.sin(turn) * sa], axis=-1)
        row[:, 1, :3] = np.stack([np.sin(turn), np.cos(turn) * ca, -np.cos(turn) * sa], axis=-1)
        row[:, 2, 1], row[:, 2, 2] = sa, ca
        row[:, 0, 3], row[:, 1, 3], row[:, 2, 3] = a / 1e3 * np.cos(turn), a / 1e3 * np.sin(turn), height
        here = here @ row
    return here @ place(table.get("dh_flange", {}))


def chain_joints(table: dict[str, Any], joints: np.ndarray) -> np.ndarray:
    """Return the angles of the description for those of the controller (N, n)."""
    angles = np.array(joints, dtype=float)
    if "coupling" in table:
        one = table["coupling"]
        angles[:, one["angle"] - 1] += one["factor"] * joints[:, one["joint"] - 1]
    return angles


def place(table: dict[str, Any]) -> np.ndarray:
    """Return the pose of ``xyz`` and ``rpy``: about the fixed axes x, y, z in this order."""
    (r, p, y), pose = table.get("rpy", (0, 0, 0)), np.eye(4)
    about_x = np.array([[1, 0, 0], [0, np.cos(r), -np.sin(r)], [0, np.sin(r), np.cos(r)]])
    about_y = np.array([[np.cos(p), 0, np.sin(p)], [0, 1, 0], [-np.sin(p), 0, np.cos(p)]])
    about_z = np.array([[np.cos(y), -np.sin(y), 0], [np.sin(y), np.cos(y), 0], [0, 0, 1]])
    pose[:3, :3], pose[:3, 3] = about_z @ about_y @ about_x, table.get("xyz", (0, 0, 0))
    return pose


def moved(joint: dict[str, Any], values: np.ndarray) -> np.ndarray:
    """Return the motion (N, 4, 4) of a joint about, or along, its axis."""
    axis = np.array(joint["axis"], dtype=float)
    axis /= np.linalg.norm(axis)
    pose = np.broadcast_to(np.eye(4), (len(values), 4, 4)).copy()
    if joint["type"] == "prismatic":
        pose[:, :3, 3] = axis * values[:, None]
        return pose
    x, y, z = axis
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sines, cosines = np.sin(values)[:, None, None], np.cos(values)[:, None, None]
    pose[:, :3, :3] = np.eye(3) + sines * across + (1 - cosines) * across @ across
    return pose
