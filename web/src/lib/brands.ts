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

// What pendants call the axes that are J1 to J6 on every page.
const AXES: Partial<Record<Brand, string[]>> = {
  kuka: ["A1", "A2", "A3", "A4", "A5", "A6"],
  yaskawa: ["S", "L", "U", "R", "B", "T"],
};

/** The name of an axis, counted from zero, as the maker's pendant has it; with that of the pages where they differ. */
export function axisName(brand: Brand | null, axis: number): string {
  const own = brand === null ? undefined : AXES[brand]?.[axis];
  return own ? `${own} (J${axis + 1})` : `J${axis + 1}`;
}
