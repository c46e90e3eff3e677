// Frames, planned poses and the doubt about the tool, as things to draw in the robot's base frame [m].

import {
  BufferGeometry,
  CanvasTexture,
  CylinderGeometry,
  Float32BufferAttribute,
  Group,
  LineBasicMaterial,
  LineSegments,
  Matrix4,
  Mesh,
  MeshLambertMaterial,
  Points,
  PointsMaterial,
  SphereGeometry,
  SRGBColorSpace,
  Sprite,
  SpriteMaterial,
  Vector3,
  type Object3D,
} from "three";
import type { URDFRobot } from "urdf-loader";
import { magnification, type FrameSeen, type PlannedPose, type ToolDoubt } from "./cell_view";
import { colour } from "./theme.svelte";
import type { CellSeen } from "./types";

export const FIELD_DEG = 32; // of the camera

const AXES = [
  ["X", "--axis-x", new Vector3(1, 0, 0)],
  ["Y", "--axis-y", new Vector3(0, 1, 0)],
  ["Z", "--axis-z", new Vector3(0, 0, 1)],
] as const;
const AXIS_M = 0.2;
const AXIS_RADIUS_M = 0.006;
const LETTER_PX = 17; // on the screen, however far away
const NAME_PX = 20;
const DOT_PX = 6;
const MOST_BONES = 6; // poses whose links are drawn; of more, they would hide the robot, and places say where it goes
const FIELD_RAD = (FIELD_DEG * Math.PI) / 180;
const GHOSTS = { to_do: "--pose-to-do", next: "--pose-next", measured: "--pose-measured" } as const; // by where the series stands

/** Set an arm's description to the controller's joints [rad]. */
export function bend(arm: URDFRobot, cellView: CellSeen, joints_rad: number[]) {
  cellView.joints.forEach((name, row) => {
    const factors = cellView.description_from_controller[row] ?? [];
    arm.setJointValue(name, factors.reduce((sum, factor, i) => sum + factor * (joints_rad[i] ?? 0), 0));
  });
  arm.updateMatrixWorld(true);
}

/** Three axes with their letters, and a name. */
export function axes(name: string): Group {
  const group = new Group();
  for (const [letter, tone, direction] of AXES) {
    const bar = new Mesh(
      new CylinderGeometry(AXIS_RADIUS_M, AXIS_RADIUS_M, AXIS_M, 8),
      new MeshLambertMaterial({ color: colour(tone) }),
    );
    bar.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), direction);
    bar.position.copy(direction).multiplyScalar(AXIS_M / 2);
    const end = text(letter, LETTER_PX, colour(tone));
    end.position.copy(direction).multiplyScalar(AXIS_M * 1.15);
    group.add(bar, end);
  }
  const label = text(name, NAME_PX, colour("--view-frame"));
  label.center.set(0.5, 2.2); // below the origin, whichever way the frame is turned
  label.userData["center_y"] = 2.2;
  group.add(label);
  return group;
}

/** A frame where it was found; one that is fixed in the flange is for the caller to hang there. */
export function frame(frameView: FrameSeen, name: string): Group {
  const group = axes(name);
  group.applyMatrix4(new Matrix4().fromArray(frameView.matrix).transpose());
  return group;
}

/** A short text that always faces the viewer, so high on the screen; ``fitTexts`` gives it its size. */
export function text(words: string, high_px: number, ink: string): Sprite {
  const canvas = document.createElement("canvas");
  const pen = canvas.getContext("2d")!;
  const font = `600 44px ${getComputedStyle(document.documentElement).fontFamily}`;
  pen.font = font;
  canvas.width = Math.ceil(pen.measureText(words).width) + 16;
  canvas.height = 60;
  pen.font = font;
  pen.textBaseline = "middle";
  pen.lineJoin = "round";
  pen.lineWidth = 9;
  pen.strokeStyle = colour("--view-halo");
  pen.strokeText(words, 8, 31);
  pen.fillStyle = ink;
  pen.fillText(words, 8, 31);
  const map = new CanvasTexture(canvas);
  map.colorSpace = SRGBColorSpace;
  const sprite = new Sprite(new SpriteMaterial({ map, depthTest: false, sizeAttenuation: false }));
  const name = words.length > 1; // and no axis' letter
  sprite.userData = { name, high_px, aspect: canvas.width / canvas.height, center_y: 0.5 };
  sprite.renderOrder = name ? 4 : 3; // letters hide no name
  return sprite;
}

/** Give every text its size in a picture of this height [CSS px]. */
export function fitTexts(root: Object3D, picture_px: number) {
  root.traverse((part) => {
    if (!(part as Sprite).isSprite) return;
    const high = (2 * Math.tan(FIELD_RAD / 2) * part.userData["high_px"]) / picture_px;
    part.scale.set(high * part.userData["aspect"], high, 1);
  });
}

export interface GhostShown {
  name: string;
  state: PlannedPose["state"];
  flange_m: number[];
}

/** Every planned pose as a thin skeleton, one of them as a whole translucent arm. */
export class Ghosts {
  readonly group = new Group();
  shown: GhostShown[] = [];
  #arm: URDFRobot;
  #cloth = new MeshLambertMaterial({ transparent: true, opacity: 0.32, depthWrite: false });
  #cellView: CellSeen;

  constructor(arm: URDFRobot, cellView: CellSeen) {
    this.#arm = arm;
    this.#cellView = cellView;
    arm.traverse((part) => {
      part.matrixAutoUpdate = true;
      if ((part as Mesh).isMesh) (part as Mesh).material = this.#cloth;
    });
    for (const joint of Object.values(arm.joints)) joint.ignoreLimits = true;
    this.group.visible = false;
  }

  show(poses: PlannedPose[], chosen: number) {
    release(this.group);
    this.group.clear();
    this.shown = [];
    this.group.visible = poses.length > 0;
    const points = { to_do: [] as Vector3[], next: [] as Vector3[], measured: [] as Vector3[] };
    const many = poses.length > MOST_BONES;
    for (const pose of poses) {
      bend(this.#arm, this.#cellView, pose.joints_rad);
      const flange = this.#arm.links["flange"]!.getWorldPosition(new Vector3());
      if (many) points[pose.state].push(flange);
      else points[pose.state].push(...this.#bonesTo(flange));
      this.shown.push({ name: pose.name, state: pose.state, flange_m: flange.toArray() });
    }
    for (const state of ["measured", "to_do", "next"] as const)
      if (points[state].length) this.group.add((many ? dots : lines)(points[state], colour(GHOSTS[state])));
    const whole = poses[chosen];
    if (!whole) return;
    bend(this.#arm, this.#cellView, whole.joints_rad);
    this.#cloth.color.set(colour(GHOSTS[whole.state]));
    this.#cloth.opacity = whole.state === "next" ? 0.5 : 0.32;
    this.group.add(this.#arm);
  }

  /** The ends of the links of the arm as it is bent, two for each. */
  #bonesTo(flange: Vector3): Vector3[] {
    const joints = this.#cellView.joints.map((name) => this.#arm.joints[name]!.getWorldPosition(new Vector3()));
    return joints.flatMap((from, i) => [from, joints[i + 1] ?? flange]);
  }
}

/** The ellipsoid about the tip, so many times larger than it is. */
export class Doubt {
  readonly group = new Group();
  times = 0;
  #ball: Mesh;

  constructor() {
    const skin = new MeshLambertMaterial({ color: colour("--doubt"), transparent: true, opacity: 0.55, depthTest: false });
    this.#ball = new Mesh(new SphereGeometry(1, 24, 16), skin);
    this.#ball.matrixAutoUpdate = false;
    this.#ball.renderOrder = 2; // seen through the tool
    this.group.add(this.#ball);
    this.group.visible = false;
  }

  show(doubt: ToolDoubt | null, flange: Object3D) {
    const hasSize = doubt !== null && doubt.semi_axes_m.length === 3;
    this.group.visible = hasSize;
    this.times = hasSize ? magnification(doubt.semi_axes_m) : 0;
    if (!hasSize) return;
    const [a, b, c] = doubt.semi_axes_m.map((size) => Math.max(size, 1e-9) * this.times) as [number, number, number];
    const e = doubt.base_ellipsoid as [number, number, number, number, number, number, number, number, number];
    const tip = flange.localToWorld(new Vector3(...doubt.tip_in_flange_m));
    const turn = new Matrix4().set(e[0], e[1], e[2], 0, e[3], e[4], e[5], 0, e[6], e[7], e[8], 0, 0, 0, 0, 1);
    this.#ball.matrix.makeTranslation(tip).multiply(turn).scale(new Vector3(a, b, c));
    this.#ball.matrixWorldNeedsUpdate = true;
  }
}

/** Give back what drawing a part holds. */
export function release(part: Object3D) {
  part.traverse((each) => {
    const { isSprite, isLineSegments, isPoints, material } = each as Sprite & LineSegments & Points;
    if (isLineSegments || isPoints) (each as LineSegments).geometry.dispose();
    if (isSprite) (material as SpriteMaterial).map?.dispose();
  });
}

function lines(points: Vector3[], ink: string): LineSegments {
  return new LineSegments(through(points), new LineBasicMaterial({ color: ink }));
}

function dots(points: Vector3[], ink: string): Points {
  return new Points(through(points), new PointsMaterial({ color: ink, size: DOT_PX, sizeAttenuation: false }));
}

function through(points: Vector3[]): BufferGeometry {
  const geometry = new BufferGeometry();
  return geometry.setAttribute("position", new Float32BufferAttribute(points.flatMap((p) => p.toArray()), 3));
}
