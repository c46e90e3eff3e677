"""Two fake cells of one drawing, with all that fake arms hide, calibrated with a noisy tracker; as projects."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.joint_terms import term_values
from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import Pose, exp_twist, homogeneous_matrix, inverse_transform
from cellcal.calibration.identification.free_parameters import parameter_values
from cellcal.calibration.identification.identify import identify_arm
from cellcal.calibration.identification.observations import PointObservations
from cellcal.calibration.identification.parameters import GRAVITY
from cellcal.calibration.identification.selection import IdentificationOptions
from cellcal.calibration.orientation import rotation_from, values_from
from cellcal.calibration.points.alignment import Alignment, alignment_text
from cellcal.calibration.points.fixture import place_points
from cellcal.drivers.fanuc.program_files.programs import BRAND
from cellcal.fake_devices.arm import SimulatedArm
from cellcal.service.engineering.parameters.calibrated_models import nominal_sha256, values_of_identification
from cellcal.service.engineering.parameters.parameter_set import ParameterSet, to_text
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from cellcal.service.engineering.programs.project import Project, read_project

MODEL = load_model("fanuc_m6ib")
TRACKER_M = 3e-5  # of one coordinate
FIXTURE_POINTS = ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (0.5, 0.6, 0.0), (0.0, 0.6, 0.15))
REFLECTORS = np.array([[0.0, 0.0, 0.0], [0.15, 0.0, -0.05], [0.0, 0.15, -0.05]])  # in the tool, from the tip
ENTERED_TOOL = homogeneous_matrix(
    rotation_from("fanuc_wpr", np.deg2rad([3.0, -20.0, 10.0])), np.array([0.03, 0.01, 0.18])
)
ENTERED_FRAME = homogeneous_matrix(
    rotation_from("fanuc_wpr", np.deg2rad([0.0, 0.0, 15.0])), np.array([0.75, -0.3, -0.25])
)
FIXTURE = homogeneous_matrix(
    rotation_from("fanuc_wpr", np.deg2rad([0.0, 0.0, 5.0])), np.array([0.72, -0.3, -0.3])
)
_APPROACH_RAD = 0.02


@dataclass(frozen=True, eq=False)
class CalibratedArm:
    """One arm as its calibration found it."""

    values: tuple
    flange_tool: np.ndarray
    base_fixture: Pose
    covariance: tuple
    held_out_m: float


@dataclass(eq=False)
class DrawnCell:
    """One arm with a tool before a fixture: the truth, and what can be measured of it."""

    name: str
    seed: int
    shift_m: float = 0.02  # of fixture and base
    turn_rad: float = 0.02
    around: float = 0.0  # how far the whole cell is turned about the base's z

    def __post_init__(self) -> None:
        self.arm = SimulatedArm.from_model(MODEL.name, self.seed, name=self.name)
        self.rng = np.random.default_rng([self.seed, len(self.name)])
        turned = exp_twist(np.array([0.0, 0.0, 0.0, 0.0, 0.0, self.around]))
        self.base_fixture = turned @ FIXTURE @ self._stray_pose(self.shift_m, self.turn_rad)
        self.flange_tool = ENTERED_TOOL @ self._stray_pose(1e-3, 5e-3)
        self.base_frame = turned @ ENTERED_FRAME  # as entered: not measured well

    def _stray_pose(self, shift_m: float, turn_rad: float) -> np.ndarray:
        scale = np.repeat([shift_m, turn_rad], 3)
        return exp_twist(scale * self.rng.uniform(-1.0, 1.0, 6))

    def true_flanges(self, joints_rad: np.ndarray) -> np.ndarray:
        """Return where the flange really is (N, 4, 4), each posture reached from below; with backlash."""
        found = []
        for joints in joints_rad:
            self.arm.put_joints(joints - _APPROACH_RAD)
            self.arm.put_joints(joints)
            self.arm.clock.advance(1.0)
            found.append(self.arm.base_flange())
        return np.array(found)

    def tips_at_fixture(self, joints_rad: np.ndarray) -> np.ndarray:
        """Return where the real tip is at the fixture (N, 4, 4)."""
        return inverse_transform(self.base_fixture) @ self.true_flanges(joints_rad) @ self.flange_tool

    def recorded_tips(self, joints_rad: np.ndarray) -> np.ndarray:
        """Return what the controller records at these joints: its tip in its user frame (N, 4, 4)."""
        return inverse_transform(self.base_frame) @ self.arm.believed_flange(joints_rad) @ ENTERED_TOOL

    def commanded_joints(self, frame_tip: np.ndarray, near_rad: np.ndarray) -> np.ndarray:
        """Return the joints that the controller computes for programmed points, by the fake's own kinematics."""
        target_flanges = self.base_frame @ frame_tip @ inverse_transform(ENTERED_TOOL)
        joints = near_rad.copy()
        for _ in range(30):
            here = self.arm.believed_flange(joints)
            columns = []
            for k in range(6):
                step = joints.copy()
                step[:, k] += 1e-6
                columns.append(_pose_gap(here, self.arm.believed_flange(step)) / 1e-6)
            jacobian = np.stack(columns, axis=2)
            joints = joints + np.linalg.solve(jacobian, _pose_gap(here, target_flanges)[:, :, None])[:, :, 0]
        assert np.abs(_pose_gap(self.arm.believed_flange(joints), target_flanges)).max() < 1e-7
        return joints

    def tracker_readings(self, joints_rad: np.ndarray, tracker: np.ndarray, reflector: int) -> np.ndarray:
        """Return what the tracker says of a reflector on the tool."""
        at = self.flange_tool[:3, :3] @ REFLECTORS[reflector] + self.flange_tool[:3, 3]
        flanges = tracker @ self.true_flanges(joints_rad)
        places = flanges[:, :3, :3] @ at + flanges[:, :3, 3]
        return places + TRACKER_M * self.rng.standard_normal(places.shape)

    def calibrate_cell(self, poses: int) -> CalibratedArm:
        """Identify arm and tool, and find the fixture, all with one tracker."""
        tracker = exp_twist(np.array([2.0, -1.0, 0.5, 0.1, -0.2, 2.0]))  # base seen from the tracker
        joints = _draw_spread(self.rng, poses)
        readings = self.tracker_readings(joints, tracker, 0)
        once = np.zeros(poses, dtype=np.intp)
        rows = PointObservations(joints, readings, np.full(poses, TRACKER_M), once)
        result = identify_arm(
            MODEL, rows, options=IdentificationOptions(level=GRAVITY, judge=False, find_breaks=False)
        )
        fit = result.robust.fit
        state = fit.state
        base_tracker = inverse_transform(state.devices[0].device_base)
        values = [
            _IdentifiedArm(p.name, p.unit, float(v), float(s), p.prior)
            for p, v, s in zip(
                fit.layout.parameters,
                parameter_values(fit.layout, state),
                np.sqrt(np.diag(fit.covariance)),
                strict=True,
            )
        ]
        arm_only = [value for value in values if value.name.startswith("J")]
        fixture = self._find_fixture(tracker, base_tracker)
        return CalibratedArm(
            values_of_identification(arm_only, fit),
            self._find_tool(state, tracker, base_tracker, joints[:20]),
            *fixture,
            float(np.sqrt(np.mean(result.fit_m**2) / 3.0)),
        )

    def _find_tool(self, state, tracker, base_tracker, joints) -> np.ndarray:
        flanges = state.arm_model.base_flange(state.moved_joints(joints, _term_values(state, joints)))
        found = [state.flange_tool[:3, 3]]
        for reflector in (1, 2):
            readings = self.tracker_readings(joints, tracker, reflector)
            in_base = readings @ base_tracker[:3, :3].T + base_tracker[:3, 3]
            local = np.einsum("nji,nj->ni", flanges[:, :3, :3], in_base - flanges[:, :3, 3])
            found.append(local.mean(axis=0))
        placed = place_points(REFLECTORS, found, 1e-9 * np.eye(9), sigma_point_m=1e-5)
        return placed.outer_inner.to_matrix()

    def _find_fixture(self, tracker, base_tracker) -> tuple[Pose, tuple]:
        points = np.array(FIXTURE_POINTS)
        true = points @ self.base_fixture[:3, :3].T + self.base_fixture[:3, 3]
        readings = (
            true @ tracker[:3, :3].T + tracker[:3, 3] + TRACKER_M * self.rng.standard_normal(points.shape)
        )
        found = readings @ base_tracker[:3, :3].T + base_tracker[:3, 3]
        placed = place_points(FIXTURE_POINTS, found, TRACKER_M**2 * np.eye(12), sigma_point_m=1e-5)
        return placed.outer_inner, placed.covariance

    def write_project(self, folder: Path, poses: int = 100, master: str = "") -> Project:
        """Calibrate, write the cell as a project with all its files, and read it."""
        found = self.calibrate_cell(poses)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "parameters.toml").write_text(self._write_parameter_set(folder, found.values))
        alignment = Alignment(
            "table", self.name, MODEL.name, FIXTURE_POINTS, found.base_fixture, found.covariance
        )
        (folder / "fixture.json").write_text(alignment_text([alignment]))
        path = folder / "project.toml"
        path.write_text(
            f'format = 1\nname = "{self.name}"\nprograms = ["*.ls"]\n'
            + (f'[master]\nproject = "{master}"\n' if master else "")
            + f'[robot]\nserial = "{self.name}"\nmodel = "{MODEL.name}"\nparameters = "parameters.toml"\n'
            f"held_out_rms_mm = {found.held_out_m * 1e3}\n"
            f"[tools.1.entered]\n{_pose_text(ENTERED_TOOL)}[tools.1.real]\n{_pose_text(found.flange_tool)}sigma_mm = 0.03\n"
            f"[frames.1]\n{_pose_text(self.base_frame)}"
            '[fixture]\nalignment = "fixture.json"\n'
        )
        return read_project(path)

    def _write_parameter_set(self, folder: Path, values: tuple) -> str:
        draft = ParameterSet(
            self.name, MODEL.name, nominal_sha256(MODEL), "2026-01-01T00:00:00Z", "test", "tracker", values
        )
        return to_text(ParameterSets(folder / "sets").save_draft(draft))


@dataclass(frozen=True)
class _IdentifiedArm:
    name: str
    unit: str
    value: float
    sigma: float
    prior: float


def work_postures(cell: DrawnCell, count: int, seed: int) -> np.ndarray:
    """Return postures with the tip over the fixture, the tool pointing down at it, the wrist well bent."""
    rng, found = np.random.default_rng(seed), []
    low, high = MODEL.lower_rad * 0.9, MODEL.upper_rad * 0.9
    while sum(map(len, found)) < count:
        joints = rng.uniform(np.maximum(low, -2.0), np.minimum(high, 2.0), (20000, 6))
        joints[:, 0] += cell.around
        tips = inverse_transform(cell.base_fixture) @ cell.arm.believed_flange(joints) @ ENTERED_TOOL
        at = tips[:, :3, 3]
        over = (np.abs(at[:, :2] - [0.25, 0.3]) < [0.3, 0.35]).all(axis=1) & (np.abs(at[:, 2] - 0.15) < 0.2)
        down = tips[:, 2, 2] < -0.3
        bent = (np.abs(np.sin(joints[:, 4])) > 0.2) & (joints[:, 4] > 0.0)
        found.append(joints[over & down & bent])
    return np.concatenate(found)[:count]


def fanuc_listing(name: str, frame_tip: np.ndarray, joints_rad: np.ndarray) -> bytes:
    """Write taught points as a FANUC listing, in this file's own words."""
    texts = BRAND.configurations.write_configurations(MODEL, joints_rad, ["N U T, 0, 0, 0"] * len(joints_rad))
    lines = [f"/PROG  {name}", "/ATTR", "OWNER\t\t= MNEDITOR;", "DEFAULT_GROUP\t= 1,*,*,*,*;", "/MN"]
    lines += [f"{i:4d}:L P[{i}] 250mm/sec FINE    ;" for i in range(1, len(texts) + 1)]
    lines.append("/POS")
    for i, (pose, text) in enumerate(zip(frame_tip, texts, strict=True), 1):
        x, y, z = pose[:3, 3] * 1e3
        w, p, r = np.rad2deg(values_from("fanuc_wpr", pose[:3, :3]))
        lines += [f"P[{i}]{{", "   GP1:", f"\tUF : 1, UT : 1,\t\tCONFIG : '{text}',"]
        lines.append(f"\tX = {x:9.3f}  mm,\tY = {y:9.3f}  mm,\tZ = {z:9.3f}  mm,")
        lines += [f"\tW = {w:9.3f} deg,\tP = {p:9.3f} deg,\tR = {r:9.3f} deg", "};"]
    return ("\r\n".join([*lines, "/END"]) + "\r\n").encode("ascii")


def _draw_spread(rng: np.random.Generator, count: int) -> np.ndarray:
    low, high = np.maximum(MODEL.lower_rad, -1.6) * 0.9, np.minimum(MODEL.upper_rad, 1.6) * 0.9
    return rng.uniform(low, high, (count, 6))


def _term_values(state, joints):
    return term_values(state.nominal, joints, state.terms)


def _pose_gap(here: np.ndarray, there: np.ndarray) -> np.ndarray:
    turn = there[:, :3, :3] @ here[:, :3, :3].swapaxes(1, 2)
    axis = 0.5 * np.stack(
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1
    )
    return np.concatenate([there[:, :3, 3] - here[:, :3, 3], axis], axis=1)


def _pose_text(pose: np.ndarray) -> str:
    x, y, z = pose[:3, 3] * 1e3
    angles = np.rad2deg(values_from("fanuc_wpr", pose[:3, :3]))
    return (
        f"position_mm = [{x:.6f}, {y:.6f}, {z:.6f}]\n"
        f"fanuc_wpr_deg = [{', '.join(f'{a:.7f}' for a in angles)}]\n"
    )
