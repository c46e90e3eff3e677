// Settings by their JSON schema: what kind of field each is, so that a new procedure needs no form of its own.

export interface Field {
  type?: string;
  anyOf?: Field[];
  enum?: unknown[];
  default?: unknown;
  $ref?: string;
  items?: Field;
  prefixItems?: Field[];
  minItems?: number;
  maxItems?: number;
  "x-file"?: boolean;
}

export type Kind = "number" | "integer" | "choice" | "yesno" | "text" | "triple" | "triples" | "pose" | "numbers" | "file" | "json";

export interface Setting {
  name: string;
  kind: Kind;
  field: Field;
  required: boolean;
}

/** The settings of a procedure, in the order of its specification. */
export function settingsOf(schema: Record<string, unknown>): Setting[] {
  const required = (schema.required ?? []) as string[];
  const fields = Object.entries((schema.properties ?? {}) as Record<string, Field>);
  return fields.map(([name, field]) => ({ name, kind: kindOf(field), field, required: required.includes(name) }));
}

/** What a technician decides: what must be told, choices, and points. The rest stands at its usual value. */
export function isEssential(setting: Setting): boolean {
  return setting.required || ["choice", "yesno", "triples", "numbers"].includes(setting.kind);
}

function kindOf(field: Field): Kind {
  const real = (field.anyOf ?? [field]).find((each) => each.type !== "null") ?? field;
  if (field["x-file"]) return "file";
  if (real.$ref?.endsWith("/Pose")) return "pose";
  if (real.enum) return "choice";
  if (real.type === "boolean") return "yesno";
  if (real.type === "number" || real.type === "integer") return real.type;
  if (real.type === "string") return "text";
  if (real.type !== "array") return "json";
  if (isTriple(real)) return "triple";
  if (real.items && isTriple(real.items)) return "triples";
  return real.items?.type === "integer" ? "numbers" : "json";
}

function isTriple(field: Field): boolean {
  return field.type === "array" && field.minItems === 3 && field.maxItems === 3;
}

/** The values that may be chosen. */
export function choicesOf(setting: Setting): string[] {
  return ((setting.field.anyOf ?? [setting.field]).find((each) => each.enum)?.enum ?? []).map(String);
}
