// Settings of two runs that differ, as rows that people read: where, what it was, what it is, and by how much.

import { language } from "./i18n.svelte";
import { sayings } from "./say.svelte";
import { fieldAt, labelOf } from "./schema";
import { unitOf, type Unit } from "./units";

export interface Row {
  path: string; // as the service names it, with a place in a list counted from 1
  title: string;
  before: string;
  after: string;
  change: string; // empty where nothing can be subtracted
}

const NOTHING = "–";
const LONGEST = 6; // numbers that are read as one thing: a point, joints

/** The rows of one setting: what has parts has a row for each part that differs. */
export function rowsOf(path: string, before: unknown, after: unknown, schema?: Record<string, unknown>): Row[] {
  if (isGroup(before) || isGroup(after)) {
    const [old, fresh] = [partsOf(before), partsOf(after)];
    const names = [...new Set([...Object.keys(old), ...Object.keys(fresh)])];
    return names.flatMap((name) => rowsOf(`${path}.${name}`, old[name], fresh[name], schema));
  }
  if (JSON.stringify(before ?? null) === JSON.stringify(after ?? null)) return [];
  const names = path.split(".");
  const unit = unitOf(names.filter((name) => !/^\d+$/.test(name)).pop() ?? "");
  return [{
    path,
    title: nameOf(path, schema),
    before: written(before, unit),
    after: written(after, unit),
    change: difference(before, after, unit),
  }];
}

/** What a path is called: "Motion · Speed of the tip", by the settings of its procedure. */
export function nameOf(path: string, schema?: Record<string, unknown>): string {
  const names: string[] = [];
  const labels = path.split(".").map((name) => {
    if (/^\d+$/.test(name)) return name;
    names.push(name);
    return sayings.say(labelOf(name, fieldAt(schema, names)));
  });
  return labels.join(" · ");
}

const isNumbers = (value: unknown): value is number[] =>
  Array.isArray(value) && value.length > 0 && value.length <= LONGEST && value.every((each) => typeof each === "number");

/** Whether a value is told part by part: a list of plain words is not. */
const isGroup = (value: unknown): boolean =>
  typeof value === "object" && value !== null && !isNumbers(value) && !(Array.isArray(value) && value.every((each) => typeof each === "string"));

function partsOf(value: unknown): Record<string, unknown> {
  if (Array.isArray(value)) return Object.fromEntries(value.map((each, i) => [String(i + 1), each]));
  return isGroup(value) ? (value as Record<string, unknown>) : {};
}

/** A value with its unit. */
export function written(value: unknown, unit: Unit): string {
  if (value === null || value === undefined || (Array.isArray(value) && value.length === 0)) return NOTHING;
  if (typeof value === "number") return number(value, unit) + unitBehind(unit);
  if (isNumbers(value)) return value.map((each) => number(each, unit)).join(" / ") + unitBehind(unit);
  if (Array.isArray(value)) return sayings.listed(...value);
  if (typeof value === "boolean") return language.t(value ? "yes" : "no");
  const words = String(value);
  const translated = sayings.say(words.replaceAll("_", " "));
  return translated === words.replaceAll("_", " ") ? words : translated;
}

function difference(before: unknown, after: unknown, unit: Unit): string {
  const [old, fresh] = [before, after].map((value) => (typeof value === "number" ? [value] : value));
  if (!isNumbers(old) || !isNumbers(fresh) || old.length !== fresh.length) return "";
  return fresh.map((each, i) => (each > old[i]! ? "+" : "") + number(each - old[i]!, unit)).join(" / ") + unitBehind(unit);
}

const number = (value: number, unit: Unit): string => {
  const digits = unit.name === "" ? (Number.isInteger(value) ? 0 : 5) : unit.digits;
  return language.number(value * unit.factor, digits);
};

/** A unit as it stands behind a number: degrees without a gap. */
export const unitBehind = (unit: Unit): string => (unit.name === "" || unit.name.startsWith("°") ? unit.name : ` ${unit.name}`);
