// The maker of a robot by its model's name: whose words stand on its pendant.

export type Brand = "fanuc" | "ur" | "kuka" | "abb" | "yaskawa";

const MARKS: [RegExp, Brand][] = [
  [/fanuc/i, "fanuc"],
  [/^ur\d|universal/i, "ur"],
  [/kuka/i, "kuka"],
  [/abb|^irb/i, "abb"],
  [/yaskawa|motoman/i, "yaskawa"],
];

/** The maker; null where the name does not say. */
export const brandOf = (model: string): Brand | null => MARKS.find(([mark]) => mark.test(model))?.[1] ?? null;
