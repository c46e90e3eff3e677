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
  rule?: string;
}

export interface Outcome {
  verdict: string;
  reason: string;
  remedy: string;
  code?: string;
  judgement?: {
    word: string;
    characteristics?: Characteristic[];
    not_verified?: string[];
    remarks?: string[];
    to_sign?: string[];
  } | null;
  signed?: { who: string; at_s: number };
  result?: unknown;
  certificate?: string | null;
  no_certificate?: string;
}

export interface Run {
  id: string;
  procedure: string;
  title: string;
  who: string; // began or resumed it; "watch" and "service" are no people
  state: "starting" | "running" | "paused" | "ended";
  step: string;
  index: number;
  expected: number;
  phases: Phase[];
  found: string[];
  events: RunEvent[];
  outcome: Outcome | null;
  hold_to_move: boolean;
  does: "" | "read" | "move" | "write" | "solve";
  instrument: string; // the role of the one that was read last
  left_s: number | null;
  series: Series | null;
}

/** Where a run stands in the plan that was approved last. */
export interface Series {
  poses: { name: string; joints_rad: number[] }[];
  next: number | null; // gone to or measured at just now
  elsewhere_rad: number[] | null; // gone to just now, where that is none of them
  measured: number[];
}

export type StepKind = "ask" | "enter" | "teach" | "capture" | "approve" | "motion" | "review" | "sign";

export interface PlannedPose {
  name: string;
  joints_rad: number[];
  way_rad: number[][]; // the corners before it
  tip_in_base_m?: number[];
}

export interface Plan {
  poses: PlannedPose[];
  most?: number | null; // poses that are gone to at most, where the measurements choose
  speed_rad_s?: number;
  duration_s?: number | null;
  checked?: string[];
  not_checked?: string[];
  predictions?: Prediction[];
  level?: string;
}

/** How well something would be known, and each class's limit for it. */
export interface Prediction {
  name: string;
  expanded: number;
  unit: string;
  limits: Record<string, number>;
  sentence: string;
}

/** What a run would bring, as far as a dry run tells. */
export interface Forecast {
  duration_s: number;
  poses: PlannedPose[];
  predictions: Prediction[];
  assumed: string[];
  not_checked: string[];
}

export interface Changed {
  name: string;
  before: number | null;
  after: number | null;
  unit: string;
}

export interface Review {
  word: string;
  limits_from: string;
  characteristics: Characteristic[];
  changes: Changed[];
  displacement?: { most_m: number; at: string; lever_m?: number } | null;
  set_aside: { step: string; reason: string }[];
  not_verified: string[];
  to_sign: string[];
  writes: boolean;
  write_anyway: string;
}

export interface AxisLever {
  name: string;
  tenth_degree_m: number;
  before?: number;
  after?: number;
  turns?: number;
  u_rad?: number;
}

/** What a page of some kind draws beside the words; each kind has its own part. */
export interface PromptData {
  points?: { name: string; state: "recorded" | "now" | "to_do" | "anew" }[];
  meter?: { of: string } | null;
  plan?: Plan;
  review?: Review;
  axes?: AxisLever[];
  count?: number; // of numbers that are asked for
  usual?: number; // of a number that is asked for, in the unit shown
  target?: { joints_rad: number[]; tolerance_rad: number };
  jog?: JogTurn; // of one axis, by a person at the pendant
  typed_counts?: { name: string; now: number; type: number }[]; // six integers for the pendant
}

export interface JogTurn {
  axis: number;
  key: "+" | "-";
  left_rad: number;
  turn_rad: number;
  advice: "turn" | "slow" | "stop" | "wrong_way" | "wrong_axis";
  other_axis: number | null;
  other_rad: number;
}

export interface Prompt {
  id: string;
  kind: "confirm" | "enter";
  key: string;
  text: string;
  unit: string;
  step: string;
  page: StepKind;
  data: PromptData;
}

export interface MeterFigure {
  name: string;
  value: number;
  unit: string;
  least: number | null;
  most: number | null;
}

/** What recording just now would be worth. */
export interface Recording {
  prompt_id: string;
  ready: boolean;
  why: string;
  words: string;
  remedy: string;
  warning: string;
  figures: MeterFigure[];
}

export interface Loss {
  robot: string;
  what: "lost" | "held" | "differs" | "unconfirmed";
  detected_by: string;
  mode: string;
  words: string;
  procedure: string | null;
  settings: Record<string, unknown>;
  reasons: string[]; // why it was not started alone
  alone_wanted: boolean; // whether the cell file wants that at all
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
  journal_end: string; // in words, that its end is missing
}

export interface Trouble {
  task: string;
  message: string;
  remedy: string;
  failures: number;
  running: boolean;
}

export interface DeviceValue {
  joints_rad?: number[];
  moving?: boolean;
  length_m?: number;
  sigma_m?: number;
  position_m?: [number, number, number];
  station?: number;
  closed?: boolean; // a probe's contact
}

export interface Device {
  role: string;
  name: string;
  state: string;
  message: string;
  remedy: string;
  live: boolean; // it tells values by itself; of others the state is asked, and a run's last reading is kept
  typed?: boolean; // its readings are typed by a person when a run asks: nothing can be too old
  asked: boolean; // by a run, just now
  age_s: number | null; // since it was heard: its value, or its state where it tells no values
  value_age_s: number | null;
  due?: string; // until when its calibration holds; empty where nobody has told
  value: DeviceValue | null;
  settle?: { std_m: number | null; limit_m: number; settled: boolean } | null;
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
  record?: Recording | null;
  guidance?: { prompt_id: string; text: string; values: unknown } | null; // of what is asked, while it is done
}

export interface Procedure {
  name: string;
  title: string;
  version: number;
  lacks: string[] | null;
  due: string | null; // when it should be run next (ISO date)
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
  | { op: "start"; procedure: string; settings?: Record<string, unknown>; hold_to_move?: boolean; accept_missing_end?: boolean }
  | { op: "resume"; run_id: string; redo_from?: string; hold_to_move?: boolean; accept_missing_end?: boolean }
  | { op: "answer"; prompt_id: string; value?: string }
  | { op: "decline"; prompt_id: string }
  | { op: "stop" }
  | { op: "pause" }
  | { op: "go_on" }
  | { op: "select_robot"; robot: string }
  | { op: "sign"; run_id: string; lines: string[] }
  | { op: "dismiss" };
