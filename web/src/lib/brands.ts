// The maker of a robot by its model's name: whose words stand on its pendant.

import type { Session } from "./types";

export type Brand = "fanuc" | "ur" | "kuka" | "abb" | "yaskawa";

const MARKS: [RegExp, Brand][] = [
  [/fanuc/i, "fanuc"],
  [/^ur\d|universal/i, "ur"],
  [/kuka/i, "kuka"],
  [/abb|^irb/i, "abb"],
  [/yaskawa|motoman/i, "yaskawa"],
];

/** The maker; null where the name does not say. */
const brandOf = (model: string): Brand | null => MARKS.find(([mark]) => mark.test(model))?.[1] ?? null;

/** The maker of the robot that a session has selected. */
export function selectedBrand(session: Session | null | undefined): Brand | null {
  const robot = session?.robots.find((each) => each.name === session.robot);
  return robot ? brandOf(robot.model) : null;
}

/** The name of an axis, counted from zero, as the pendant of the selected robot shows it. */
export function axisName(session: Session | null | undefined, axis: number): string {
  const robot = session?.robots.find((each) => each.name === session.robot);
  return robot?.axis_names?.[axis] ?? `J${axis + 1}`;
}
