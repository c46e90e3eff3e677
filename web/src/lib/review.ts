// Reviews, comparisons, parameter versions and trends as the service tells them, and how their figures are written.

import type { Review as AnyReview } from "./api_types";
import { fetchInTurn } from "./device";
import { language } from "./i18n.svelte";
import { learn } from "./messages";

export type {
  CertificateCheck as Verified, Displacement, FigureTrend as TrendSeen, ReviewPoint, RunHead, RunLine, RunsCompared,
  SetDifference as SetsCompared, SetHead, Validation, WorkPlace as Place,
} from "./api_types";

/** A review as it is drawn: the service leaves nothing out. */
export type Review = Required<Omit<AnyReview, "along" | "u_of" | "messages">> & {
  along: "wire" | "space" | "touch" | "place";
  u_of: "target" | "tip" | "origin" | "hook";
};

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

const TURN_MS = 4000;

/** Ask the service; what it says is wrong is thrown with its remedy. */
export async function fetchJson<T>(address: string, body?: unknown): Promise<T> {
  const how: RequestInit | undefined =
    body === undefined
      ? undefined
      : { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
  const answer = await fetchInTurn(() => fetch(address, how), TURN_MS);
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
  const [unitName, factor, digits] = UNITS[unit] ?? plainly(unit, Math.abs(value), Number.isInteger(value));
  const written = language.number(value * factor, digits).replace(/^-(?=[0.,]*$)/, "");
  const plus = sign && value > 0 ? "+" : "";
  return `${plus}${written}${unitName === "°" || unitName === "°/m" ? "" : " "}${unitName}`.trim();
}

function plainly(unit: string, size: number, whole: boolean): [string, number, number] {
  if (unit === "turn") return [language.t("unit_turn"), 1, whole ? 0 : 3];
  return [unit === "1" ? "" : unit, 1, whole ? 0 : size < 100 ? 4 : 1];
}

/** What tells a run from others of its procedure: its id is the procedure's name, which no page shows, and this. */
export const runNumber = (run: { run_id: string; procedure: string }): string =>
  run.run_id.startsWith(`${run.procedure}-`) ? run.run_id.slice(run.procedure.length + 1) : run.run_id;
