// Settings by their JSON schema: what kind of field each is, so that a new procedure needs no form of its own.

import names from "./setting_names.json";

export interface Field {
  type?: string;
  properties?: Record<string, Field>;
  required?: string[];
  anyOf?: Field[];
  enum?: unknown[];
  default?: unknown;
  $ref?: string;
  items?: Field;
  prefixItems?: Field[];
  minItems?: number;
  maxItems?: number;
  "x-file"?: boolean;
  "x-tags"?: { lengths: string[]; angles: string[]; conventions: Record<string, string> }; // what a file of tags may be in
}

export type Kind =
  | "number" | "integer" | "choice" | "yesno" | "text" | "triple" | "triples" | "pose" | "numbers" | "file"
  | "group" | "list" | "row" | "json"; // a row: so many numbers

/** What parts are made of, by name, as a JSON schema keeps them. */
export type Known = Record<string, Field>;

export interface Setting {
  name: string;
  path: string; // with what it is a part of: room.surroundings.margin_m
  kind: Kind;
  field: Field;
  required: boolean;
  known: Known;
}

/** The settings of a procedure, in the order of its specification. */
export function settingsOf(schema: Record<string, unknown>): Setting[] {
  return partsIn(schema as Field, (schema.$defs ?? {}) as Known, "");
}

/** The parts of a setting that is a group. */
export const partsOf = (setting: Setting): Setting[] => partsIn(resolved(setting.field, setting.known), setting.known, `${setting.path}.`);

/** What each member of a list is; its place in the list is its name where there is no other. */
export function memberOf(setting: Setting, at: number): Setting {
  const field = resolved(setting.field, setting.known).items ?? {};
  return { name: setting.name, path: `${setting.path}.${at}`, kind: kindOf(field, setting.known), field, required: false, known: setting.known };
}

/** How many numbers a row has. */
export const lengthOf = (setting: Setting): number => resolved(setting.field, setting.known).minItems ?? 0;

// Names that do not tell a person enough, or stand twice in one form.
const SAID: Record<string, string> = names;

/** A name as it is said: without its unit, which stands beside the value. */
export const plainName = (name: string): string => SAID[name] ?? name.replace(/_(m|rad|s|rad_s|m_s)$/, "").replaceAll("_", " ");

function partsIn(field: Field, known: Known, prefix: string): Setting[] {
  const required = field.required ?? [];
  return Object.entries(field.properties ?? {}).map(([name, each]) => ({
    name, path: prefix + name, kind: kindOf(each, known), field: each, required: required.includes(name), known,
  }));
}

/** A field as it is when it is there, a name of another schema looked up. */
function resolved(field: Field, known: Known): Field {
  const real = (field.anyOf ?? [field]).find((each) => each.type !== "null") ?? field;
  return known[real.$ref?.split("/").pop() ?? ""] ?? real;
}

/** What a technician decides: what must be told, choices, and points. The rest stands at its usual value. */
export function isEssential(setting: Setting): boolean {
  return setting.required || ["choice", "yesno", "triples", "numbers"].includes(setting.kind);
}

function kindOf(field: Field, known: Known): Kind {
  if (field["x-file"]) return "file";
  if ((field.anyOf ?? [field]).some((each) => each.$ref?.endsWith("/Pose"))) return "pose";
  const real = resolved(field, known);
  if (real.enum) return "choice";
  if (real.type === "boolean") return "yesno";
  if (real.type === "number" || real.type === "integer") return real.type;
  if (real.type === "string") return "text";
  if (real.type === "object" && real.properties) return "group";
  if (real.type !== "array") return "json";
  if (isTriple(real)) return "triple";
  if (real.prefixItems?.every((each) => each.type === "number" || each.type === "integer")) return "row";
  if (!real.items) return "json";
  if (isTriple(real.items)) return "triples";
  if (real.items.type === "integer") return "numbers";
  return kindOf(real.items, known) === "json" ? "json" : "list";
}

function isTriple(field: Field): boolean {
  return field.type === "array" && field.minItems === 3 && field.maxItems === 3;
}

/** The values that may be chosen. */
export function choicesOf(setting: Setting): string[] {
  return ((setting.field.anyOf ?? [setting.field]).find((each) => each.enum)?.enum ?? []).map(String);
}
