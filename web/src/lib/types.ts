// What the service tells; the field names are those of its OpenAPI description.

export interface Phase {
  name: string;
  repeats: number | null;
  adaptive: boolean;
}

export interface RunEvent {
  n: number;
  kind: string;
  step: string;
  message: string;
}

export interface Characteristic {
  name: string;
  value: number;
  unit: string;
  standard_uncertainty: number;
  coverage: number; // U is coverage times standard_uncertainty
  limit: number | null;
  decision: string | null;
}

export interface Outcome {
  verdict: string;
  reason: string;
  remedy: string;
  code?: string;
  judgement?: { word: string; characteristics?: Characteristic[]; not_verified?: string[]; remarks?: string[] } | null;
  result?: unknown;
  certificate?: string | null;
  no_certificate?: string;
}

export interface Run {
  id: string;
  procedure: string;
  title: string;
  state: "starting" | "running" | "paused" | "ended";
  step: string;
  index: number;
  expected: number;
  phases: Phase[];
  found: string[];
  events: RunEvent[];
  outcome: Outcome | null;
  hold_to_move: boolean;
}

export interface Prompt {
  id: string;
  kind: "confirm" | "enter";
  key: string;
  text: string;
  unit: string;
  step: string;
}

export interface Loss {
  robot: string;
  detected_by: string;
  mode: string;
  words: string;
  procedure: string | null;
  settings: Record<string, unknown>;
  reasons: string[];
}

export interface Session {
  rev: number;
  cell: string;
  robots: { name: string; model: string; serial: string }[];
  robot: string;
  level: string;
  connection: { connected: boolean; message: string; remedy: string };
  run: Run | null;
  prompt: Prompt | null;
  waits_for_hold: boolean;
  losses: Loss[];
}

export interface Device {
  role: string;
  name: string;
  state: string;
  message: string;
  remedy: string;
  age_s: number | null;
  value: { joints_rad?: number[]; moving?: boolean; length_m?: number; sigma_m?: number } | null;
}

type Triple = [number, number, number];

export interface CellSeen {
  robot: string;
  model: string;
  title: string;
  joints: string[];
  description_from_controller: number[][];
  boxes: { name: string; base_box: number[]; size_m: Triple }[];
  balls: { name: string; centre_in_base_m: Triple; radius_m: number }[];
  planes: { name: string; point_in_base_m: Triple; normal_in_base: Triple }[];
  wire: { name: string; anchor_in_base_m: Triple; hook_in_flange_m: Triple } | null;
  remarks: string[];
}

export interface Live {
  rev: number;
  at_s: number;
  devices: Device[];
}

export interface Procedure {
  name: string;
  title: string;
  version: number;
  lacks: string[] | null;
  settings: Record<string, unknown>;
}

export interface PointSeen {
  name: string;
  value_m: number;
  used: boolean;
  reason: string;
}

export interface SeriesSeen {
  kind: "errors" | "spread";
  what: string;
  points: PointSeen[];
}

export interface RunPoints {
  readings: { step: string; at_utc: string; used: boolean; reason: string; length_m: number | null; samples: number }[];
  series: SeriesSeen[];
}

export interface RunDetail extends RunLine {
  spec: Record<string, unknown>;
  findings: { step: string; value: unknown }[];
  result: unknown;
  judgement: {
    word?: string;
    characteristics?: Characteristic[];
    not_verified?: string[];
    remarks?: string[];
  } | null;
}

export interface RunLine {
  run_id: string;
  procedure: string;
  started_utc: string;
  state: string;
  reason: string;
}

export type Order =
  | { op: "start"; procedure: string; settings?: Record<string, unknown>; hold_to_move?: boolean }
  | { op: "resume"; run_id: string; redo_from?: string; hold_to_move?: boolean }
  | { op: "answer"; prompt_id: string; value?: string }
  | { op: "decline"; prompt_id: string }
  | { op: "stop" }
  | { op: "pause" }
  | { op: "go_on" }
  | { op: "select_robot"; robot: string }
  | { op: "dismiss" };
