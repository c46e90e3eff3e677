// What the pages know of the service. Its answers are described by itself (api_types.ts); here stands what its description
// leaves open: what the live channel sends, what a page of some kind draws, and the words that a text can be.

import type * as Api from "./api_types";

export type Phase = Api.PhaseSeen;

export type RunEvent = Api.RunEvent;

export type Characteristic = Api.CharacteristicSeen;

export type Outcome = Api.OutcomeSeen;

export type Run = Omit<Api.RunSeen, "does"> & { does: "" | "read" | "move" | "write" | "solve" };

/** Where a run stands in the plan that was approved last. */
export type Series = Api.PlanSeen;

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
export type Prediction = Api.PredictionSeen;

/** What a run would bring, as far as a dry run tells. */
export type Forecast = Api.ForecastSeen;

export type Changed = Api.ChangeSeen;

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
  counts?: Record<string, number[]>; // of encoders, one for each axis
  target?: HandTarget;
  jog?: JogTurn; // of one axis, by a person at the pendant
  axis_name?: string; // of the axis that the work is at, as its maker calls it
  typed_counts?: { name: string; now: number; type: number }[]; // six integers for the pendant
}

/** Where a person brings the arm at the pendant; corners and pace only where it is jogged. */
export interface HandTarget {
  joints_rad: number[];
  tolerance_rad: number;
  by_way_rad?: number[][];
  pace_rad_s?: number;
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

export type Prompt = Omit<Api.PromptSeen, "data" | "page"> & { data: PromptData; page: StepKind };

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

export type Loss = Omit<Api.LossSeen, "what"> & { what: "lost" | "held" | "differs" | "unconfirmed" | "another" };

export type Session = Omit<Api.SessionState, "run" | "prompt" | "losses"> & {
  run: Run | null;
  prompt: Prompt | null;
  losses: Loss[];
};

export type Trouble = Api.TroubleSeen;

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
  stop?: { message: string; remedy: string } | null; // what stops a robot, also one that has lost its position
  live: boolean; // it tells values by itself; of others the state is asked, and a run's last reading is kept
  typed?: boolean; // its readings are typed by a person when a run asks: nothing can be too old
  asked: boolean; // by a run, just now
  age_s: number | null; // since it was heard: its value, or its state where it tells no values
  value_age_s: number | null;
  due?: string; // until when its calibration holds; empty where nobody has told
  value: DeviceValue | null;
  settle?: { std_m: number | null; limit_m: number; settled: boolean } | null;
}

export type CellSeen = Api.CellSeen;

export interface Live {
  rev: number;
  at_s: number;
  devices: Device[];
  record?: Recording | null;
  guidance?: { prompt_id: string; text: string; values: unknown } | null; // of what is asked, while it is done
}

export type Procedure = Omit<Api.ProcedureSeen, "intention" | "minutes"> & {
  intention: "lost" | "tool" | "work" | "accurate" | "check";
  minutes: [number, number];
};

export type PointSeen = Api.PointSeen;

export type SeriesSeen = Omit<Api.PointSeriesSeen, "kind"> & { kind: "errors" | "spread" };

export type RunPoints = Omit<Api.RunPoints, "series"> & { series: SeriesSeen[] };

export type RunDetail = Api.RunDetail;

export type RunLine = Api.RunLine;

export type Order =
  | Api.StartRun
  | Api.ResumeRun
  | Api.AnswerPrompt
  | Api.DeclinePrompt
  | Api.StopRun
  | Api.PauseRun
  | Api.ContinueRun
  | Api.SelectRobot
  | Api.SignOff
  | Api.DismissRun;
