// The robot in its cell as a picture, drawn only when something changed, and never more than twelve times a second; where
// the processor computes every pixel, three times a second and without smoothing: it has other work, the robot's above all.
//
// Everything is in the robot's base frame, metres, z up. Nothing here is measured: it shows what the cell file and the
// model tables tell, in the posture that the controller tells.

import {
  BoxGeometry,
  Box3,
  Color,
  CylinderGeometry,
  DirectionalLight,
  DoubleSide,
  GridHelper,
  Group,
  HemisphereLight,
  Matrix4,
  Mesh,
  MeshLambertMaterial,
  PerspectiveCamera,
  PlaneGeometry,
  Quaternion,
  Scene,
  SphereGeometry,
  Vector3,
  WebGLRenderer,
  type BufferGeometry,
  type Material,
  type Object3D,
} from "three";
import URDFLoader, { type URDFRobot } from "urdf-loader";
import type { FrameSeen, PlannedPose, ToolDoubt } from "./cell_view";
import { axes, bend, Doubt, FIELD_DEG, fitTexts, frame, Ghosts, release, text, type GhostShown } from "./overlays";
import { spreadNames } from "./names_apart";
import { colour } from "./theme.svelte";
import type { CellSeen } from "./types";

const LEAST_MS = 1000 / 12;
const LEAST_PLAIN_MS = 1000 / 3;
const STILL_RAD = 5e-5; // a smaller turn moves no pixel
const UP = new Vector3(0, 0, 1);
const WIRE_RADIUS_M = 0.006; // drawn thicker than it is, or nobody would see it

/** What tests see of the picture. */
export interface Shown {
  robot: string;
  joints_rad: number[];
  flange_m: number[];
  frames: number; // pictures drawn so far
  most_hz: number; // pictures a second, at most
  ghosts: GhostShown[];
  axes: string[]; // names of the frames that are drawn
  wire_m: number[][]; // its two ends, where there is one
  ellipsoid: { semi_axes_m: number[]; times: number } | null;
}

declare global {
  interface Window {
    __robot?: Shown;
  }
}

export class RobotScene {
  readonly shown: Shown;
  #renderer: WebGLRenderer;
  #scene = new Scene();
  #camera = new PerspectiveCamera(FIELD_DEG, 1, 0.05, 60);
  #arm: URDFRobot;
  #ghosts: Ghosts;
  #doubt = new Doubt();
  #frames: Object3D[] = [];
  #wire: Mesh | null = null;
  #cellView: CellSeen;
  #bounds = new Box3();
  #turn = -0.9; // of the camera about the base's z, and its height above the horizon [rad]
  #rise = 0.35;
  #high_px = 300; // of the picture
  #timer: ReturnType<typeof setTimeout> | undefined;
  #lastMs = 0;
  #leastMs: number;

  constructor(canvas: HTMLCanvasElement, cellView: CellSeen, description: string, { plainly = false } = {}) {
    this.#leastMs = plainly ? LEAST_PLAIN_MS : LEAST_MS;
    this.#renderer = new WebGLRenderer({ canvas, antialias: !plainly, alpha: true });
    this.#renderer.setPixelRatio(plainly ? 1 : Math.min(devicePixelRatio, 2));
    this.#cellView = cellView;
    this.#arm = new URDFLoader().parse(description);
    this.#arm.traverse((part) => (part.matrixAutoUpdate = true));
    for (const joint of Object.values(this.#arm.joints)) joint.ignoreLimits = true; // the controller's are others
    const sun = new DirectionalLight(colour("--view-sun"), 2.2);
    sun.position.set(2, -3, 5);
    this.#scene.add(new HemisphereLight(colour("--view-sun"), colour("--view-ground"), 1.9), sun, this.#arm);
    this.#ghosts = new Ghosts(new URDFLoader().parse(description), cellView);
    this.#scene.add(this.#surroundings(), this.#ghosts.group, this.#doubt.group);
    this.#camera.up.copy(UP);
    this.shown = {
      robot: cellView.robot, joints_rad: [], flange_m: [], frames: 0, most_hz: 1000 / this.#leastMs, ghosts: [], axes: [],
      wire_m: [], ellipsoid: null,
    };
    this.frames([], "base");
    window.__robot = this.shown;
  }

  /** Show the posture of the controller's joints [rad]. */
  pose(joints_rad: number[]) {
    const before = this.shown.joints_rad;
    if (before.length > 0 && joints_rad.every((angle, i) => Math.abs(angle - (before[i] ?? Infinity)) < STILL_RAD)) return;
    this.shown.joints_rad = [...joints_rad];
    bend(this.#arm, this.#cellView, joints_rad);
    const flange = this.#arm.links["flange"]!;
    this.shown.flange_m = flange.getWorldPosition(new Vector3()).toArray();
    if (before.length === 0) this.#bounds.setFromObject(this.#arm);
    this.#stretchWire(flange);
    this.#keepInView(flange.getWorldPosition(new Vector3()));
    this.draw();
  }

  /** Show planned poses; ``chosen`` is the one that is drawn whole. */
  ghosts(poses: PlannedPose[], chosen: number) {
    if (poses.length === 0 && this.shown.ghosts.length === 0) return;
    this.#ghosts.show(poses, chosen);
    this.shown.ghosts = this.#ghosts.shown;
    for (const { flange_m } of this.shown.ghosts) this.#bounds.expandByPoint(new Vector3().fromArray(flange_m));
    this.#look();
    this.draw();
  }

  /** Show the base's axes and those of the frames that were found; ``base`` is what people call the base. */
  frames(found: FrameSeen[], base: string, name: (frameView: FrameSeen) => string = (frameView) => frameView.name) {
    for (const drawn of this.#frames) {
      release(drawn);
      drawn.removeFromParent();
    }
    const flange = this.#arm.links["flange"]!;
    this.#frames = found.map((frameView) => {
      const drawn = frame(frameView, name(frameView));
      (frameView.fixed_in === "flange" ? flange : this.#scene).add(drawn);
      return drawn;
    });
    const own = axes(base);
    this.#scene.add(own);
    this.#frames.push(own);
    fitTexts(this.#scene, this.#high_px);
    this.shown.axes = [base, ...found.map(name)];
    this.draw();
  }

  /** Show how surely the tip is known; null while nobody has said it for this posture. */
  doubt(toolDoubt: ToolDoubt | null) {
    this.#doubt.show(toolDoubt, this.#arm.links["flange"]!);
    const times = this.#doubt.times;
    const before = this.shown.ellipsoid;
    this.shown.ellipsoid = times > 0 && toolDoubt ? { semi_axes_m: toolDoubt.semi_axes_m, times } : null;
    if (before !== this.shown.ellipsoid) this.draw();
  }

  /** Fit the canvas to its place on the page [CSS px]. */
  resize(width: number, height: number) {
    if (width < 1 || height < 1) return;
    this.#renderer.setSize(width, height, false);
    this.#camera.aspect = width / height;
    this.#high_px = height;
    fitTexts(this.#scene, height);
    this.#look();
    this.draw();
  }

  /** Walk round the robot. */
  turn(around_rad: number, up_rad: number) {
    this.#turn += around_rad;
    this.#rise = Math.min(1.45, Math.max(-0.1, this.#rise + up_rad));
    this.#look();
    this.draw();
  }

  /** Draw soon; many wishes are one picture. */
  draw() {
    if (this.#timer !== undefined) return;
    const wait = Math.max(0, this.#leastMs - (performance.now() - this.#lastMs));
    this.#timer = setTimeout(() => {
      this.#timer = undefined;
      this.#lastMs = performance.now();
      this.#scene.updateMatrixWorld();
      this.#camera.updateMatrixWorld();
      spreadNames(this.#scene, this.#camera, this.#high_px * this.#camera.aspect, this.#high_px);
      this.#renderer.render(this.#scene, this.#camera);
      this.shown.frames += 1;
    }, wait);
  }

  dispose() {
    clearTimeout(this.#timer);
    this.#scene.traverse((part) => {
      const { geometry, material } = part as Mesh<BufferGeometry, Material>;
      geometry?.dispose();
      material?.dispose();
    });
    this.#renderer.dispose();
    if (window.__robot === this.shown) delete window.__robot;
  }

  // The wire

  #stretchWire(flange: Object3D) {
    const wireView = this.#cellView.wire;
    if (!wireView) return;
    const from = new Vector3(...wireView.anchor_in_base_m);
    const to = flange.localToWorld(new Vector3(...wireView.hook_in_flange_m));
    if (!this.#wire) {
      this.#wire = mesh(new CylinderGeometry(1, 1, 1, 8), "--view-wire");
      const anchorBox = mesh(new BoxGeometry(0.11, 0.11, 0.11), "--view-house");
      anchorBox.position.copy(from);
      this.#scene.add(this.#wire, anchorBox);
      this.#bounds.expandByPoint(from);
    }
    this.shown.wire_m = [from.toArray(), to.toArray()];
    const along = to.clone().sub(from);
    this.#wire.position.copy(from).addScaledVector(along, 0.5);
    this.#wire.scale.set(WIRE_RADIUS_M, along.length(), WIRE_RADIUS_M);
    this.#wire.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), along.normalize());
  }

  // What stands in the cell

  #surroundings(): Group {
    const group = new Group();
    for (const box of this.#cellView.boxes) {
      const part = mesh(new BoxGeometry(...box.size_m), "--view-solid", 0.75);
      part.applyMatrix4(new Matrix4().fromArray(box.base_box).transpose());
      group.add(part, named(box.name, part.position.clone().add(new Vector3(0, 0, box.size_m[2] / 2 + 0.06))));
    }
    for (const ball of this.#cellView.balls) {
      const part = mesh(new SphereGeometry(ball.radius_m, 24, 16), "--view-solid", 0.75);
      part.position.set(...ball.centre_in_base_m);
      group.add(part, named(ball.name, part.position.clone().add(new Vector3(0, 0, ball.radius_m + 0.06))));
    }
    for (const plane of this.#cellView.planes) {
      const normal = new Vector3(...plane.normal_in_base).normalize();
      const point = new Vector3(...plane.point_in_base_m);
      const nearest = normal.clone().multiplyScalar(point.dot(normal));
      if (normal.z > 0.95) group.add(...floor(nearest, normal));
      else group.add(wall(nearest, normal));
    }
    return group;
  }

  // The camera

  /** The view widens when the arm reaches out of it; it never narrows by itself. */
  #keepInView(point: Vector3) {
    this.#bounds.expandByPoint(point);
    this.#bounds.expandByPoint(new Vector3());
    this.#look();
  }

  #look() {
    if (this.#bounds.isEmpty()) return;
    const middle = this.#bounds.getCenter(new Vector3());
    const radius = 0.5 * this.#bounds.getSize(new Vector3()).length();
    const half = (FIELD_DEG * Math.PI) / 360;
    const narrow = Math.min(half, Math.atan(Math.tan(half) * this.#camera.aspect));
    const away = radius / Math.sin(narrow);
    const flat = away * Math.cos(this.#rise);
    this.#camera.position.set(
      middle.x + flat * Math.cos(this.#turn),
      middle.y + flat * Math.sin(this.#turn),
      middle.z + away * Math.sin(this.#rise),
    );
    this.#camera.lookAt(middle);
    this.#camera.updateProjectionMatrix();
  }
}

function mesh(geometry: BufferGeometry, tone: `--${string}`, opacity = 1): Mesh {
  const material = new MeshLambertMaterial({ color: new Color(colour(tone)), transparent: opacity < 1, opacity });
  return new Mesh(geometry, material);
}

function named(name: string, at: Vector3): Object3D {
  const label = text(name, 17, colour("--view-name"));
  label.position.copy(at);
  return label;
}

/** A floor with its grid and, where the base stands above it, a column: the column is for the eye only. */
function floor(nearest: Vector3, normal: Vector3): Object3D[] {
  const grid = new GridHelper(4, 16, colour("--view-grid-middle"), colour("--view-grid"));
  grid.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), normal);
  grid.position.copy(nearest);
  const height = -nearest.z;
  if (height < 0.05) return [grid];
  const column = mesh(new CylinderGeometry(0.13, 0.2, height, 32), "--view-column");
  column.rotation.x = Math.PI / 2;
  column.position.copy(nearest).multiplyScalar(0.5);
  return [grid, column];
}

function wall(nearest: Vector3, normal: Vector3): Object3D {
  const part = mesh(new PlaneGeometry(3, 2), "--view-solid", 0.18);
  (part.material as MeshLambertMaterial).side = DoubleSide;
  part.applyQuaternion(new Quaternion().setFromUnitVectors(UP, normal));
  part.position.copy(nearest);
  return part;
}
