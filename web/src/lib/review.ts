// Reviews, comparisons, parameter versions and trends as the service tells them, and how their figures are written.

import { language } from "./i18n.svelte";
import { learn } from "./messages";

export interface ReviewPoint {
  step: string;
  used: boolean;
  outlier: boolean;
  residual_m: number;
  deviations: number;
  reason: string;
}

export interface Spread {
  mean_m: number;
  rms_m: number;
  max_m: number;
  u_m: number;
}

export interface Validation {
  before: Spread;
  after: Spread;
  points: { step: string; before_m: number; after_m: number }[];
}

export interface Place {
  in_base_m: [number, number, number];
  error_m: number;
  u_m: number;
}

export interface Review {
  run_id: string;
  along: "wire" | "space" | "touch" | "place";
  signed: boolean;
  least: number;
  points: ReviewPoint[];
  rms_m: number | null;
  max_m: number | null;
  u_m: number | null;
  u_of: "target" | "tip" | "origin" | "hook";
  signed_rms_m: number | null;
  signed_u_m: number | null;
  values: { name: string; unit: string; value: number; signed: number }[];
  validation: Validation | null;
  places: Place[];
}

export interface Verified {
  run_id: string;
  word: string;
  finding: "intact" | "tampered" | "unknown_key" | "unreadable";
  sentence: string;
  sha256: string;
  public_key: string;
  by_this_cell: boolean;
}

export interface RunHead {
  run_id: string;
  procedure: string;
  started_utc: string;
  state: string;
  word: string;
  robot_serial: string;
}

export interface RunsCompared {
  before: RunHead;
  after: RunHead;
  settings: { name: string; before: unknown; after: unknown }[];
  figures: {
    name: string;
    unit: string;
    before: number | null;
    after: number | null;
    difference: number | null;
    expanded_uncertainty: number | null;
    changed: boolean | null;
  }[];
}

export interface SetHead {
  robot_serial: string;
  version: number;
  model: string;
  made_at: string;
  made_by: string;
  source: string;
  note: string;
  rolls_back_to: number;
  sha256: string;
}

export interface SetsCompared {
  before: SetHead;
  after: SetHead;
  changes: {
    name: string;
    unit: string;
    before: number | null;
    after: number | null;
    difference: number;
    deviations: number | null;
    undetermined: ("before" | "after")[];
  }[];
}

export interface Displacement {
  most_m: number;
  mean_m: number;
  postures: number;
  tip_in_flange_m: [number, number, number];
  left_out: string[];
}

export interface TrendSeen {
  name: string;
  unit: string;
  points: {
    run_id: string;
    started_utc: string;
    value: number;
    expanded_uncertainty: number;
    limit: number | null;
    decision: string | null;
  }[];
}

/** One dot of a trend. */
export interface TrendPoint {
  at_utc: string;
  label: string;
  value: number;
  u: number | null; // expanded
  limit: number | null;
}

export class ServiceError extends Error {
  code: string;
  remedy: string;
  constructor(code: string, message: string, remedy: string) {
    super(message);
    this.code = code;
    this.remedy = remedy;
  }
}

/** Ask the service; what it says is wrong is thrown with its remedy. */
export async function fetchJson<T>(address: string, body?: unknown): Promise<T> {
  const how: RequestInit | undefined =
    body === undefined
      ? undefined
      : { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
  const answer = await fetch(address, how);
  if (answer.ok) return learn(await answer.json());
  const content = learn(await answer.json().catch(() => ({})));
  throw new ServiceError(content.code ?? "error", content.message ?? answer.statusText, content.remedy ?? "");
}

const UNITS: Record<string, [string, number, number]> = {
  m: ["mm", 1e3, 3],
  rad: ["°", 180 / Math.PI, 4],
  "rad/m": ["°/m", 180 / Math.PI, 4],
  count: ["", 1, 0],
};

/** A figure in the unit that people read: the service keeps metres and radians. */
export function figure(value: number | null | undefined, unit: string, sign = false): string {
  if (value === null || value === undefined) return "–";
  const [unitName, factor, digits] = UNITS[unit] ?? plainly(unit, Number.isInteger(value));
  const written = language.number(value * factor, digits).replace(/^-(?=[0.,]*$)/, "");
  const plus = sign && value > 0 ? "+" : "";
  return `${plus}${written}${unitName === "°" || unitName === "°/m" ? "" : " "}${unitName}`.trim();
}

function plainly(unit: string, whole: boolean): [string, number, number] {
  if (unit === "turn") return [language.t("unit_turn"), 1, whole ? 0 : 3];
  return [unit === "1" ? "" : unit, 1, whole ? 0 : 4];
}

export const local = (utc: string): string =>
  new Date(utc).toLocaleString(language.locale === "zh" ? "zh-Hans" : language.locale);
