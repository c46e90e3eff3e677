// Quantities as people read and type them. The service speaks SI; a name's ending tells its unit.

export interface Unit {
  name: string; // as shown
  factor: number; // shown = SI times factor
  digits: number;
}

const PER_DEGREE = 180 / Math.PI;
const NONE: Unit = { name: "", factor: 1, digits: 3 };
const BY_ENDING: [string, Unit][] = [
  ["_rad_s", { name: "°/s", factor: PER_DEGREE, digits: 1 }],
  ["_m_s", { name: "mm/s", factor: 1000, digits: 1 }],
  ["_rad", { name: "°", factor: PER_DEGREE, digits: 3 }],
  ["_m", { name: "mm", factor: 1000, digits: 3 }],
  ["_s", { name: "s", factor: 1, digits: 1 }],
];
const BY_SYMBOL: Record<string, Unit> = {
  m: { name: "mm", factor: 1000, digits: 3 },
  rad: { name: "°", factor: PER_DEGREE, digits: 3 },
  s: { name: "s", factor: 1, digits: 1 },
  "m/s": { name: "mm/s", factor: 1000, digits: 1 },
  "rad/s": { name: "°/s", factor: PER_DEGREE, digits: 1 },
  "": NONE,
  "1": { name: "", factor: 1, digits: 3 },
  count: { name: "", factor: 1, digits: 0 },
  turn: { name: "rev", factor: 1, digits: 3 },
};

/** The unit of a value of a run, by the name it is kept under. */
export function unitOf(name: string): Unit {
  return BY_ENDING.find(([end]) => name.endsWith(end))?.[1] ?? NONE;
}

/** The unit of a figure, by its SI symbol. */
export function unitOfSymbol(symbol: string): Unit {
  return BY_SYMBOL[symbol] ?? { name: symbol, factor: 1, digits: 3 };
}

/** A bound as people read it, never outside of what is allowed: 0.3 rad is 17.1°, not 17.1887°; a round one is itself. */
export function roundBound(bound: number, towards: "up" | "down"): number {
  const exact = Number(bound.toFixed(4));
  if (Math.abs(bound - exact) <= 1e-9 * Math.abs(bound)) return exact;
  const step = 10 ** (Math.floor(Math.log10(Math.abs(bound))) - 2);
  const steps = bound / step;
  const near = Math.round(steps);
  const whole = Math.abs(steps - near) < 1e-9 * Math.abs(steps) ? near : towards === "up" ? Math.ceil(steps) : Math.floor(steps);
  return Number((whole * step).toPrecision(3));
}

const WRITTEN: Record<string, string> = { inch: "in", deg: "°" };

/** A unit that a file may be in, as people write it in every language. */
export const unitOfFile = (name: string): string => WRITTEN[name] ?? name;

const SAME_UNIT: Record<string, Record<string, number>> = {
  mm: { mm: 1, cm: 10, m: 1000, µm: 1e-3, μm: 1e-3, um: 1e-3 },
  "°": { "°": 1, deg: 1, rad: PER_DEGREE, mrad: PER_DEGREE / 1000 },
};
const NUMBER = /^[-+]?(\d+([.,]\d*)?|[.,]\d+)(e[-+]?\d+)?$/i;
const GROUPED = /^([-+]?\d{1,3})((?: \d{3})+)(?=$|[.,])/; // thousands with blanks between
const TWO_WAYS = /^[-+]?[1-9]\d{0,2}([.,])\d{3}$/; // a mark before three digits: of thousands, or of decimals
const WITH_UNIT = /^(.*?[\d.,])\s*(°|[a-zµμ][a-z/]*)$/i;

/** What was typed, with the signs of any keyboard as the plain ones: １２，５ and −3 can be pasted. */
const plainly = (text: string): string =>
  text.normalize("NFKC").replace(/[\u2010-\u2015\u2212]/g, "-").replace(/。/g, ".").replace(/\s+/g, " ").trim();

/** The two numbers that may be meant by 1,500 where the comma is no decimal sign; null where it is plain. */
export function twoWays(text: string, decimal: "," | "."): [thousands: string, decimals: string] | null {
  const plain = plainly(text);
  const mark = TWO_WAYS.exec(plain)?.[1];
  if (mark === undefined || mark === decimal) return null;
  return [plain.replace(mark, ""), plain.replace(mark, decimal).replace(/0+$/, "").replace(/[.,]$/, "")];
}

/** The number a person typed, comma or point, with its unit or without; null where it is none. */
export function typedNumber(text: string, unit = ""): number | null {
  const plain = plainly(text).replace(/^([-+]) /, "$1").replace(GROUPED, (_, first: string, rest: string) => first + rest.replaceAll(" ", ""));
  const [, digits = plain, typedUnit = ""] = NUMBER.test(plain) ? [] : (WITH_UNIT.exec(plain) ?? []);
  const factor = typedUnit === "" || typedUnit === unit ? 1 : SAME_UNIT[unit]?.[typedUnit];
  if (factor === undefined || !NUMBER.test(digits)) return null;
  const number = Number((Number(digits.replace(",", ".")) * factor).toPrecision(15));
  return Number.isFinite(number) ? number : null;
}

/** What a person may have meant who typed `typed` in another unit than is shown; null where it looks right. */
export function meantOtherwise(typed: number, unit: Unit, usual: number | null): { number: number; unit: string } | null {
  if (typed === 0) return null;
  if (unit.name === "mm") {
    const small = usual === null ? Math.abs(typed) < 3 && !Number.isInteger(typed) : Math.abs(typed) < Math.abs(usual) / 200;
    return small ? { number: typed * 1000, unit: "m" } : null;
  }
  if (unit.name === "°" && usual !== null && Math.abs(usual) > 3 && Math.abs(typed) < Math.abs(usual) / 20) {
    return { number: typed * PER_DEGREE, unit: "rad" };
  }
  return null;
}

/** W, P, R [rad] about the fixed axes x, y, z as a quaternion (w, x, y, z). */
export function quaternionOf([w, p, r]: number[]): [number, number, number, number] {
  const [cx, sx] = [Math.cos((w ?? 0) / 2), Math.sin((w ?? 0) / 2)];
  const [cy, sy] = [Math.cos((p ?? 0) / 2), Math.sin((p ?? 0) / 2)];
  const [cz, sz] = [Math.cos((r ?? 0) / 2), Math.sin((r ?? 0) / 2)];
  return [
    cx * cy * cz + sx * sy * sz,
    sx * cy * cz - cx * sy * sz,
    cx * sy * cz + sx * cy * sz,
    cx * cy * sz - sx * sy * cz,
  ];
}

/** The other way round. */
export function turnsOf([w, x, y, z]: number[]): [number, number, number] {
  const [a, b, c, d] = [w ?? 1, x ?? 0, y ?? 0, z ?? 0];
  return [
    Math.atan2(2 * (a * b + c * d), 1 - 2 * (b * b + c * c)),
    Math.asin(Math.min(1, Math.max(-1, 2 * (a * c - d * b)))),
    Math.atan2(2 * (a * d + b * c), 1 - 2 * (c * c + d * d)),
  ];
}
