// Where the robot stands, what is safe to do and how to go on: for a person who comes back to a run half-way.

import type { Key } from "./i18n.svelte";
import type { RunLine } from "./review";
import type { Session } from "./types";

export interface Standing {
  colour: "warn" | "bad" | "good";
  title: Key;
  safe: Key;
}

/** States of a run that can be gone on with. */
const HALF_WAY = ["interrupted", "cell_failed", "declined", "cancelled"];

/** What to say of a run that is under way or was just left. */
export function standingOf(session: Session, moving: boolean, stopped: boolean): Standing {
  if (stopped) return { colour: "bad", title: "stand_stopped", safe: "stand_stopped_safe" };
  if (moving) return { colour: "warn", title: "stand_moving", safe: "stand_moving_safe" };
  if (session.run?.state === "paused") return { colour: "warn", title: "stand_paused", safe: "stand_paused_safe" };
  if (session.prompt) return { colour: "warn", title: "stand_asks", safe: "stand_asks_safe" };
  if (session.waits_for_hold) return { colour: "warn", title: "stand_hold", safe: "stand_hold_safe" };
  return { colour: "warn", title: "stand_works", safe: "stand_works_safe" };
}

/** A robot of the cell, and its newest run that ended half-way with nothing done since. */
export interface LeftRun {
  robot: string;
  run: RunLine;
  mayGoOn: boolean; // with a lost position, only what brings it back
}

/** What the selected robot can go on with, and every robot's run that may have moved it since. */
export function leftRuns(runs: RunLine[], session: Session): LeftRun[] {
  return session.robots.flatMap(({ name, serial }) => {
    const run = runs.find((each) => each.robot_serial === serial);
    if (!run || !HALF_WAY.includes(run.state)) return [];
    const mayGoOn = session.losses.every((each) => each.robot !== name || each.procedure === run.procedure);
    return run.in_doubt !== "" || (name === session.robot && mayGoOn) ? [{ robot: name, run, mayGoOn }] : [];
  });
}
