// What is drawn over the robot: planned poses, frames that runs found, how surely the tool's tip is known.

import type { Prompt, Series } from "./types";

export interface PlannedPose {
  name: string;
  joints_rad: number[];
  state: "to_do" | "next" | "measured";
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

/** The poses of the plan that a question shows; else those of the series that a run is in; none where there is neither. */
export function plannedPoses(prompt: Prompt | null, series: Series | null): PlannedPose[] {
  const planned = prompt?.data?.plan?.poses;
  if (Array.isArray(planned) && !(series && prompt?.data.target)) return drawable(planned); // a pose asked for by hand is in its series
  if (!series) return [];
  const poses = drawable(series.poses);
  for (const place of series.measured) if (poses[place]) poses[place].state = "measured";
  if (series.next !== null && poses[series.next]) poses[series.next]!.state = "next";
  return series.elsewhere_rad ? [...poses, { name: "", joints_rad: series.elsewhere_rad, state: "next" }] : poses;
}

function drawable(poses: { name?: unknown; joints_rad?: unknown }[]): PlannedPose[] {
  return poses
    .filter((pose) => Array.isArray(pose?.joints_rad) && pose.joints_rad.every(Number.isFinite))
    .slice(0, MOST_POSES)
    .map((pose) => ({ name: String(pose.name ?? ""), joints_rad: pose.joints_rad as number[], state: "to_do" }));
}

/** How many times larger than life an ellipsoid is drawn: 1, 2 or 5 times a power of ten. */
export function magnification(semi_axes_m: number[]): number {
  const longest = Math.max(...semi_axes_m, 1e-9);
  const target_m = DRAWN_M / longest;
  const power = 10 ** Math.floor(Math.log10(target_m));
  return [5, 2, 1].map((step) => step * power).find((step) => step <= target_m) ?? power;
}

/** Joints as one text that changes only when the arm does: a hundredth of a degree is no move. */
export const posture = (joints_rad: number[]): string => joints_rad.map((angle) => angle.toFixed(4)).join(",");
