// What is drawn over the robot: planned poses, frames that runs found, how surely the tool's tip is known.

export interface PlannedPose {
  name: string;
  joints_rad: number[];
}

export interface FrameSeen {
  kind: "tool" | "user" | "fixture";
  name: string;
  fixed_in: "base" | "flange";
  matrix: number[]; // (4, 4) row by row
  run_id: string;
  at_utc: string;
}

export interface ToolDoubt {
  joints_rad: number[];
  tip_in_flange_m: [number, number, number];
  parts: ("tool" | "arm")[];
  semi_axes_m: number[]; // k = 2, longest first; empty where nothing is known
  base_ellipsoid: number[]; // (3, 3) row by row, axes as columns
  runs: string[];
}

const DRAWN_M = 0.25; // at most so long is the longest half axis in the picture
const MOST_POSES = 400;

/** The poses of the plan that a question shows; none where it shows no plan. */
export function plannedPoses(prompt: unknown): PlannedPose[] {
  const poses = (prompt as { data?: { plan?: { poses?: unknown } } } | null)?.data?.plan?.poses;
  if (!Array.isArray(poses)) return [];
  return poses
    .filter((pose) => Array.isArray(pose?.joints_rad) && pose.joints_rad.every(Number.isFinite))
    .slice(0, MOST_POSES)
    .map((pose) => ({ name: String(pose.name ?? ""), joints_rad: pose.joints_rad as number[] }));
}

/** How many times larger than life an ellipsoid is drawn: 1, 2 or 5 times a power of ten. */
export function magnification(semi_axes_m: number[]): number {
  const longest = Math.max(...semi_axes_m, 1e-9);
  const wanted = DRAWN_M / longest;
  const power = 10 ** Math.floor(Math.log10(wanted));
  return [5, 2, 1].map((step) => step * power).find((step) => step <= wanted) ?? power;
}

/** Joints as one text that changes only when the arm does: a hundredth of a degree is no move. */
export const posture = (joints_rad: number[]): string => joints_rad.map((angle) => angle.toFixed(4)).join(",");
