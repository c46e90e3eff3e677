// Settings by their JSON schema: what kind of field each is, what it is called and what a person is told about it.
// The words stand where a setting is defined; a new procedure needs no form of its own.

import { unitOf, unitOfSymbol, type Unit } from "./units";

export interface Field {
  type?: string;
  title?: string;
  description?: string;
  minimum?: number;
  maximum?: number;
  exclusiveMinimum?: number;
  exclusiveMaximum?: number;
  "x-group"?: string;
  "x-unit"?: string;
  "x-basic"?: boolean;
  "x-axes"?: boolean; // axes, counted from 1
  "x-drawing"?: string;
  "x-choices"?: Record<string, string>;
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
  definitions: Known;
}

/** The settings of a procedure, in the order of its specification. */
export function settingsOf(schema: Record<string, unknown>): Setting[] {
  return partsIn(schema as Field, (schema.$defs ?? {}) as Known, "");
}

/** The parts of a setting that is a group: a group that is usual as a whole has a usual value for each, so none is needed. */
export function partsOf(setting: Setting): Setting[] {
  const parts = partsIn(resolved(setting.field, setting.definitions), setting.definitions, `${setting.path}.`);
  const usual = setting.field.default as Record<string, unknown> | null | undefined;
  if (typeof usual !== "object" || usual === null) return parts;
  return parts.map((part) =>
    usual[part.name] === undefined ? part : { ...part, field: { ...part.field, default: usual[part.name] }, required: false },
  );
}

/** What each member of a list is; its place in the list is its name where there is no other. */
export function memberOf(setting: Setting, at: number): Setting {
  const field = resolved(setting.field, setting.definitions).items ?? {};
  return { name: setting.name, path: `${setting.path}.${at}`, kind: kindOf(field, setting.definitions), field, required: false, definitions: setting.definitions };
}

/** How many numbers a row has. */
export const lengthOf = (setting: Setting): number => resolved(setting.field, setting.definitions).minItems ?? 0;

/** What a setting is called: as it is where it is defined; of one that is no more, its name without underscores. */
export const labelOf = (name: string, field: Field | undefined): string =>
  field?.title ?? name.replace(/_(m|rad|s|rad_s|m_s)$/, "").replaceAll("_", " ");

/** The unit that a setting is typed in. */
export const unitOfSetting = (setting: Setting): Unit => {
  const symbol = setting.field["x-unit"];
  return symbol === undefined ? unitOf(setting.name) : unitOfSymbol(symbol);
};

/** The field at a path of settings, a place in a list left out: room.surroundings.planes.name. */
export function fieldAt(schema: Record<string, unknown> | undefined, names: string[]): Field | undefined {
  const definitions = (schema?.$defs ?? {}) as Known;
  let field = schema as Field | undefined;
  for (const name of names) {
    let there = field ? resolved(field, definitions) : undefined;
    while (there?.type === "array" && there.items) there = resolved(there.items, definitions);
    field = there?.properties?.[name];
  }
  return field;
}

/** Settings that a technician knows, and those for an engineer in their groups. */
export function grouped(settings: Setting[]): { basic: Setting[]; groups: [string, Setting[]][] } {
  const groups = new Map<string, Setting[]>();
  for (const each of settings.filter((one) => !isBasic(one))) {
    const group = each.field["x-group"] ?? "";
    groups.set(group, [...(groups.get(group) ?? []), each]);
  }
  return { basic: settings.filter(isBasic), groups: [...groups] };
}

/** The least and the most that a number may be, SI. */
export function boundsOf(setting: Setting): [number | undefined, number | undefined] {
  const field = resolved(setting.field, setting.definitions);
  return [field.minimum ?? field.exclusiveMinimum, field.maximum ?? field.exclusiveMaximum];
}

/** Which of the two bounds a number must not reach: a deviation is more than 0, never 0 itself. */
export function openBoundsOf(setting: Setting): [boolean, boolean] {
  const field = resolved(setting.field, setting.definitions);
  return [field.minimum === undefined && field.exclusiveMinimum !== undefined, field.maximum === undefined && field.exclusiveMaximum !== undefined];
}

function partsIn(field: Field, definitions: Known, prefix: string): Setting[] {
  const required = field.required ?? [];
  return Object.entries(field.properties ?? {}).map(([name, each]) => ({
    name, path: prefix + name, kind: kindOf(each, definitions), field: each, required: required.includes(name), definitions,
  }));
}

/** A field as it is when it is there, a name of another schema looked up. */
function resolved(field: Field, definitions: Known): Field {
  const real = (field.anyOf ?? [field]).find((each) => each.type !== "null") ?? field;
  return definitions[real.$ref?.split("/").pop() ?? ""] ?? real;
}

/** What a technician knows: at most four of a procedure. The rest stands at its usual value. */
export const isBasic = (setting: Setting): boolean => setting.required || setting.field["x-basic"] === true;

function kindOf(field: Field, definitions: Known): Kind {
  if (field["x-file"]) return "file";
  if ((field.anyOf ?? [field]).some((each) => each.$ref?.endsWith("/Pose"))) return "pose";
  const real = resolved(field, definitions);
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
  return kindOf(real.items, definitions) === "json" ? "json" : "list";
}

function isTriple(field: Field): boolean {
  return field.type === "array" && field.minItems === 3 && field.maxItems === 3;
}

/** The values that may be chosen, and what each is called. */
export function choicesOf(setting: Setting): [string, string][] {
  const words = setting.field["x-choices"] ?? {};
  const values = (setting.field.anyOf ?? [setting.field]).find((each) => each.enum)?.enum ?? [];
  return values.map(String).map((value) => [value, words[value] ?? value]);
}
