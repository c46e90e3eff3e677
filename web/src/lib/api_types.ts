// Written by `make types` from the service's OpenAPI description. Do not edit: a test compares it with the service.

export interface AnswerPrompt {
  op: "answer";
  prompt_id: string;
  value?: string;
}

export interface BallSeen {
  name: string;
  centre_in_base_m: [number, number, number];
  radius_m: number;
}

export interface BoxSeen {
  name: string;
  base_box: number[];
  size_m: [number, number, number];
}

export interface CellInput {
  kind: "here" | "kept" | "carried";
  name?: string;
  files?: UploadedFile[];
  tools?: EnteredFrame[];
  frames?: EnteredFrame[];
  held_out_rms_m?: number | null;
}

export interface CellSeen {
  robot: string;
  model: string;
  title: string;
  arm_rgb: string;
  joints: string[];
  description_from_controller: number[][];
  boxes: BoxSeen[];
  balls: BallSeen[];
  planes: PlaneSeen[];
  wire: WirePlacement | null;
  remarks: string[];
  messages?: TextMessages;
}

export interface CertificateCheck {
  run_id: string;
  word: string;
  finding: CheckFinding;
  sentence: string;
  sha256: string;
  public_key: string;
  by_this_cell: boolean;
  messages?: TextMessages;
}

export interface ChangeSeen {
  name: string;
  before: number | null;
  after: number | null;
  unit: string;
}

export interface CharacteristicSeen {
  name: string;
  value: number;
  unit: string;
  standard_uncertainty: number;
  coverage: number;
  expanded_uncertainty: number;
  limit: number | null;
  decision: string | null;
  rule: string;
  budget: ContributionSeen[];
}

export type CheckFinding = "intact" | "tampered" | "unknown_key" | "unreadable";

export interface CheckPoint {
  step: string;
  before_m: number;
  after_m: number;
}

export interface ConnectionSeen {
  connected: boolean;
  message: string;
  remedy: string;
}

export interface ContinueRun {
  op: "go_on";
}

export interface ContributionSeen {
  name: string;
  standard_uncertainty: number;
  source: string;
}

export interface ControlRequest {
  do: "ask" | "withdraw" | "give" | "refuse";
}

export interface ControlSeen {
  mine: boolean;
  holder: string | null;
  asking: string | null;
  asking_mine: boolean;
  remaining_s: number | null;
  approved: string;
  approved_by: string;
  messages?: TextMessages;
}

export interface DeclinePrompt {
  op: "decline";
  prompt_id: string;
}

export interface DeterminedParameter {
  name: string;
  unit: string;
  deviation: number;
  standard_uncertainty: number;
}

export interface DeviceEnrolment {
  token: string;
  public_key: string;
}

export interface DeviceProof {
  device: string;
  challenge: string;
  signature: string;
}

export interface DismissRun {
  op: "dismiss";
}

export interface Displacement {
  most_m: number;
  mean_m: number;
  postures: number;
  tip_in_flange_m: [number, number, number];
  left_out: string[];
  messages?: TextMessages;
}

export interface Done {
  ok: true;
  messages?: TextMessages;
}

export interface DryRunSeen {
  procedure: string;
  title: string;
  version: number;
  robot: string;
  serial: string;
  settings: Record<string, unknown>;
  lacks: string[];
  phases: PhaseSeen[];
  expected_steps: number;
  forecast: ForecastSeen | null;
  problem: string;
  messages?: TextMessages;
}

export interface EnteredFrame {
  position_m: [number, number, number];
  quaternion?: [number, number, number, number];
  name: string;
}

export interface ErrorSpread {
  mean_m: number;
  rms_m: number;
  max_m: number;
  u_m: number;
}

export interface FigureChange {
  name: string;
  unit: string;
  before: number | null;
  after: number | null;
  difference: number | null;
  expanded_uncertainty: number | null;
  changed: boolean | null;
}

export interface FigureTrend {
  name: string;
  unit: string;
  points: TrendPoint[];
  messages?: TextMessages;
}

export interface FindingSeen {
  step: string;
  value: unknown;
}

export interface ForecastSeen {
  duration_s: number;
  poses: PlannedPoseSeen[];
  speed_rad_s: number | null;
  predictions: PredictionSeen[];
  assumed: string[];
  lacks: string[];
  not_checked: string[];
  planned: Record<string, number>;
}

export interface FrameSeen {
  kind: string;
  name: string;
  fixed_in: string;
  matrix: number[];
  run_id: string;
  at_utc: string;
  messages?: TextMessages;
}

export interface HiddenParameters {
  names: string[];
  behind: string;
}

export interface HoldOrder {
  op: "hold";
  held: boolean;
  at_s?: number | null;
}

export interface IdentifyFault {
  message: string;
  remedy: string;
}

export interface IdentifyJob {
  id: string;
  file: string;
  robot: string;
  serial: string;
  model: string;
  who: string;
  at_utc: string;
  wishes: IdentifyWishes;
  joints: string;
  check: string;
  layout: string;
  headings: string[];
  understood: Record<string, unknown>;
  state: "waiting" | "running" | "done" | "failed" | "stopped";
  stage: string;
  done: number;
  total: number;
  fault: IdentifyFault | null;
  saved_version: number | null;
  messages?: TextMessages;
}

export interface IdentifyJobWithResult {
  id: string;
  file: string;
  robot: string;
  serial: string;
  model: string;
  who: string;
  at_utc: string;
  wishes: IdentifyWishes;
  joints: string;
  check: string;
  layout: string;
  headings: string[];
  understood: Record<string, unknown>;
  state: "waiting" | "running" | "done" | "failed" | "stopped";
  stage: string;
  done: number;
  total: number;
  fault: IdentifyFault | null;
  saved_version: number | null;
  result: IdentifyResult | null;
  newest_version: number;
  messages?: TextMessages;
}

export interface IdentifyOverview {
  robots: RobotToIdentify[];
  jobs: IdentifyJob[];
  most_bytes: number;
  levels: string[];
  conventions: string[];
  angle_units: string[];
  length_units: string[];
  messages?: TextMessages;
}

export interface IdentifyRequest {
  file?: UploadedFile | null;
  again?: string;
  robot?: string;
  description?: RobotDescription | null;
  joints?: UploadedFile | null;
  check?: UploadedFile | null;
  layout?: UploadedFile | null;
  wishes?: IdentifyWishes;
}

export interface IdentifyResult {
  report: Record<string, unknown>;
  parameters: DeterminedParameter[];
  ripple_count: number;
  unknown: UnknownParameters[];
  row_errors: RowErrors;
  understood: Record<string, unknown>;
  series: MeasuredSeriesErrors[];
  not_savable: IdentifyFault | null;
}

export interface IdentifyWishes {
  level?: 0 | 1 | 2 | 3 | 4 | 5 | null;
  columns?: Record<string, string[]>;
  units?: Record<string, string>;
  convention?: string;
  joint_coupling?: "" | "controller" | "geometric";
  sheet?: string;
}

export interface JobPreview {
  title: string;
  cell: string;
  parameters: string;
  counts: Record<string, number>;
  verdicts: Record<string, number>;
  collisions_checked: boolean;
  largest_shift_m: number | null;
  largest_expected_m: number | null;
  largest_uncorrected_m: number | null;
  programs: ProgramPreview[];
  refused: RefusedFile[];
  notes: string[];
  page_size: number;
  picture: PointsPicture;
}

export interface JobWithPreview {
  id: string;
  do: string;
  who: string;
  at_utc: string;
  state: "waiting" | "running" | "done" | "failed" | "stopped";
  done: number;
  total: number;
  fault: ProgramsFault | null;
  preview: JobPreview | null;
  messages?: TextMessages;
}

export interface JudgementSeen {
  word: "pass" | "fail" | "undecided";
  characteristics: CharacteristicSeen[];
  limits_from: string;
  not_verified: string[];
  remarks: string[];
  changes: ChangeSeen[];
  set_aside: SetAsideSeen[];
  to_sign: string[];
}

export interface LossSeen {
  robot: string;
  what: string;
  detected_by: string;
  mode: string;
  words: string;
  procedure: string | null;
  settings: Record<string, unknown>;
  reasons: string[];
  alone_wanted: boolean;
}

export interface MeasuredSeriesErrors {
  name: string;
  rows: number;
  rejected: number;
  is_held_out: boolean;
  before_m: number;
  held_out_m: number;
  fit_m: number;
}

export interface NameAndPin {
  name: string;
  secret: string;
}

export interface OrderDone {
  ok?: boolean;
  rev: number;
  messages?: TextMessages;
}

export interface OrderRefusalResponse {
  code: string;
  message: string;
  remedy: string;
  session?: Record<string, unknown> | null;
  messages?: TextMessages;
}

export interface OutcomeSeen {
  verdict: string;
  reason: string;
  remedy: string;
  code?: string;
  judgement?: JudgementSeen | null;
  result?: unknown;
  certificate?: string | null;
  no_certificate?: string;
  signed?: SignedSeen | null;
}

export interface ParameterDifference {
  name: string;
  unit: string;
  before: number | null;
  after: number | null;
  difference: number;
  deviations: number | null;
  undetermined: ("before" | "after")[];
}

export interface PauseRun {
  op: "pause";
}

export interface PersonSeen {
  name: string;
  role: string;
  locked: boolean;
  alone: boolean;
  rights: string[];
}

export interface PhaseSeen {
  name: string;
  repeats: number | null;
  adaptive: boolean;
}

export interface PhotoInfo {
  sha256: string;
  media_type: string;
  bytes: number;
  what: string;
  who: string;
  at_utc: string;
  messages?: TextMessages;
}

export interface PhotoUpload {
  what?: "witness marks";
  content_base64: string;
}

export interface PicturePoint {
  place_m: [number, number, number];
  step: number;
  left: boolean;
  label: string;
}

export interface PinAgain {
  secret: string;
}

export interface PlanSeen {
  poses: SeriesPose[];
  next: number | null;
  elsewhere_rad: number[] | null;
  measured: number[];
}

export interface PlaneSeen {
  name: string;
  point_in_base_m: [number, number, number];
  normal_in_base: [number, number, number];
}

export interface PlannedPoseSeen {
  label: string;
  joints_rad: number[];
}

export interface PointPreview {
  program: string;
  point: string;
  line: number;
  kind: string;
  user_frame: string | null;
  tool: string | null;
  verdict: "fits" | "reach" | "limit" | "singular" | "flip" | "collision" | "unknown";
  reason: string;
  changed: boolean;
  shift_m: number | null;
  turn_rad: number | null;
  expected_m: number | null;
  before_m: [number, number, number] | null;
  after_m: [number, number, number] | null;
  configuration_before: string;
  configuration_after: string;
}

export interface PointSeen {
  name: string;
  value_m: number;
  used: boolean;
  reason: string;
}

export interface PointSeriesSeen {
  kind: string;
  what: string;
  points: PointSeen[];
}

export interface PointsPage {
  total: number;
  pages: number;
  points: PointPreview[];
  messages?: TextMessages;
}

export interface PointsPicture {
  in_base: boolean;
  points: PicturePoint[];
  colours: string[];
  edges_m: number[];
  not_drawn: number;
}

export interface PoseInput {
  position_m: [number, number, number];
  quaternion?: [number, number, number, number];
}

export interface PredictionSeen {
  name: string;
  expanded: number;
  unit: string;
  limits: Record<string, number>;
  sentence: string;
}

export interface PressedOrder {
  id: string;
  rev: number;
  order: StartRun | ResumeRun | AnswerPrompt | DeclinePrompt | StopRun | PauseRun | ContinueRun | SelectRobot | DismissRun | SignOff | HoldOrder;
}

export interface PreviewRequest {
  procedure: string;
  robot?: string | null;
  settings?: Record<string, unknown>;
}

export interface ProcedureSeen {
  name: string;
  title: string;
  version: number;
  lacks: string[] | null;
  due: string | null;
  remedies: string[];
  uses: string;
  intention: string;
  when: string;
  minutes: number[];
  for_other_controllers: boolean;
  needs_position: boolean;
  commands_motion: boolean;
  settings: Record<string, unknown>;
  messages?: TextMessages;
}

export interface ProgramPreview {
  program: string;
  file: string;
  brand: string;
  points: number;
  changed: number;
  unchanged: number;
  left: number;
  largest_shift_m: number | null;
  largest_expected_m: number | null;
}

export interface ProgramsFault {
  message: string;
  remedy: string;
}

export interface ProgramsJob {
  id: string;
  do: string;
  who: string;
  at_utc: string;
  state: "waiting" | "running" | "done" | "failed" | "stopped";
  done: number;
  total: number;
  fault: ProgramsFault | null;
  messages?: TextMessages;
}

export interface ProgramsOverview {
  robots: RobotOfCell[];
  projects: StoredProject[];
  jobs: ProgramsJob[];
  most_files?: number;
  most_bytes?: number;
  messages?: TextMessages;
}

export interface ProgramsRequest {
  do: "compensate" | "download" | "move" | "clone";
  cell: CellInput;
  clone?: CellInput | null;
  offset?: PoseInput | null;
  frame?: string;
  joints?: "move" | "keep" | null;
  files?: UploadedFile[];
  own_files?: boolean;
  language?: "en" | "de" | "es" | "zh";
}

export interface PromptSeen {
  id: string;
  kind: "confirm" | "enter";
  key: string;
  text: string;
  unit: string;
  step: string;
  page: string;
  data: Record<string, unknown>;
  yes: string;
  no: string;
  question: string;
  is_folded: boolean;
  drawing: string;
}

export interface ReadingSeen {
  step: string;
  at_utc: string;
  used: boolean;
  reason: string;
  length_m: number | null;
  samples: number;
}

export interface RefusalResponse {
  code: string;
  message: string;
  remedy: string;
  messages?: TextMessages;
}

export interface RefusedFile {
  message: string;
  remedy: string;
  file: string;
  line: number;
  column: number;
}

export interface ResumeRun {
  op: "resume";
  run_id: string;
  redo_from?: string | null;
  hold_to_move?: boolean;
  accept_missing_end?: boolean;
}

export interface Review {
  run_id: string;
  along: string;
  signed: boolean;
  least: number;
  points?: ReviewPoint[];
  rms_m?: number | null;
  max_m?: number | null;
  u_m?: number | null;
  u_of?: string;
  signed_rms_m?: number | null;
  signed_u_m?: number | null;
  values?: ReviewValue[];
  validation?: Validation | null;
  places?: WorkPlace[];
  messages?: TextMessages;
}

export interface ReviewPoint {
  step: string;
  used: boolean;
  outlier: boolean;
  residual_m: number;
  deviations: number;
  reason: string;
}

export interface ReviewValue {
  name: string;
  unit: string;
  value: number;
  signed: number;
}

export interface RobotDescription {
  file: UploadedFile;
  base?: string;
  tip?: string;
}

export interface RobotOfCell {
  robot: string;
  serial: string;
  model: string;
  version: number | null;
  tools: string[];
  frames: string[];
}

export interface RobotSeen {
  name: string;
  model: string;
  serial: string;
  axis_names: string[];
}

export interface RobotToIdentify {
  robot: string;
  serial: string;
  model: string;
  version: number | null;
}

export interface RollbackRequest {
  id: string;
  to: number;
  newest: number;
  note?: string;
}

export interface RowErrors {
  rows: number[];
  before_m: number[];
  held_out_m: number[];
  rejected: boolean[];
  rows_per_point: number;
}

export interface RunDetail {
  run_id: string;
  procedure: string;
  started_utc: string;
  state: string;
  reason: string;
  word: string;
  robot_serial: string;
  begun_by: string;
  begun_as: string[];
  in_doubt: string;
  spec: Record<string, unknown>;
  findings: FindingSeen[];
  result: unknown;
  judgement: JudgementSeen | null;
  messages?: TextMessages;
}

export interface RunEvent {
  n: number;
  kind: string;
  step: string;
  message: string;
}

export interface RunHead {
  run_id: string;
  procedure: string;
  started_utc: string;
  state: string;
  word: string;
  robot_serial: string;
}

export interface RunLine {
  run_id: string;
  procedure: string;
  started_utc: string;
  state: string;
  reason: string;
  word: string;
  robot_serial: string;
  begun_by: string;
  begun_as: string[];
  in_doubt: string;
  messages?: TextMessages;
}

export interface RunPoints {
  readings: ReadingSeen[];
  series: PointSeriesSeen[];
  messages?: TextMessages;
}

export interface RunSeen {
  id: string;
  procedure: string;
  title: string;
  who: string;
  state: "starting" | "running" | "paused" | "ended";
  step: string;
  index: number;
  expected: number;
  phases: PhaseSeen[];
  found: string[];
  events: RunEvent[];
  outcome: OutcomeSeen | null;
  hold_to_move: boolean;
  does: string;
  instrument: string;
  left_s: number | null;
  series: PlanSeen | null;
}

export interface RunsCompared {
  before: RunHead;
  after: RunHead;
  settings: SettingChange[];
  figures: FigureChange[];
  messages?: TextMessages;
}

export interface SaveRequest {
  id: string;
  newest: number;
  note?: string;
}

export interface SecondApproval {
  pressed: PressedOrder;
  name: string;
  secret: string;
}

export interface SelectRobot {
  op: "select_robot";
  robot: string;
}

export interface SeriesPose {
  name: string;
  joints_rad: number[];
}

export interface SessionSeen {
  session: SessionState | null;
  wanted: "device" | "person" | "pin" | "nothing";
  person: PersonSeen | null;
  demo: boolean;
  troubles: TroubleSeen[];
  messages?: TextMessages;
}

export interface SessionState {
  rev: number;
  cell: string;
  robots: RobotSeen[];
  robot: string;
  level: string;
  connection: ConnectionSeen;
  run: RunSeen | null;
  prompt: PromptSeen | null;
  waits_for_hold: boolean;
  losses: LossSeen[];
  journal_end: string;
  troubles: TroubleSeen[];
}

export interface SetAsideSeen {
  step: string;
  reason: string;
}

export interface SetDifference {
  before: SetHead;
  after: SetHead;
  changes: ParameterDifference[];
  messages?: TextMessages;
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
  messages?: TextMessages;
}

export interface SetParameter {
  name: string;
  unit: "rad" | "m" | "rad/m" | "1";
  value: number;
  standard_uncertainty: number | null;
  determined: boolean;
}

export interface SettingChange {
  name: string;
  before: unknown;
  after: unknown;
}

export interface SignInDone {
  wanted: "device" | "person" | "pin" | "nothing";
  person: SignedInPerson | null;
  ok: true;
  messages?: TextMessages;
}

export interface SignInState {
  wanted: "device" | "person" | "pin" | "nothing";
  person: SignedInPerson | null;
  messages?: TextMessages;
}

export interface SignOff {
  op: "sign";
  run_id: string;
  lines: string[];
}

export interface SignedDocument {
  content: Record<string, unknown>;
  format: string;
  sha256: string;
  signature: Record<string, string>;
  messages?: TextMessages;
}

export interface SignedInPerson {
  name: string;
  role: string;
  locked: boolean;
  alone: boolean;
  rights: string[];
}

export interface SignedSeen {
  who: string;
  at_s: number;
}

export interface StartRun {
  op: "start";
  procedure: string;
  settings?: Record<string, unknown>;
  hold_to_move?: boolean;
  accept_missing_end?: boolean;
}

export interface StopRun {
  op: "stop";
}

export interface StoredProject {
  name: string;
  serial: string;
  master: string;
  programs: number;
  readable: boolean;
}

export interface TextMessage {
  template: string;
  arguments: Record<string, string | TextMessage>;
}

export type TextMessages = Record<string, TextMessage>;

export interface TipUncertainty {
  joints_rad: number[];
  tip_in_flange_m: [number, number, number];
  parts: string[];
  semi_axes_m?: number[];
  base_ellipsoid?: number[];
  runs?: string[];
  messages?: TextMessages;
}

export interface TrendPoint {
  run_id: string;
  started_utc: string;
  value: number;
  expanded_uncertainty: number;
  limit: number | null;
  decision: string | null;
}

export interface TroubleSeen {
  task: string;
  message: string;
  remedy: string;
  failures: number;
  running: boolean;
}

export interface UnknownParameters {
  cure: string;
  hidden: HiddenParameters[];
}

export interface UploadedFile {
  name: string;
  content_base64: string;
}

export interface Validation {
  before: ErrorSpread;
  after: ErrorSpread;
  points: CheckPoint[];
}

export interface WhatIfRequest {
  used: string[];
}

export interface WholeSet {
  robot_serial: string;
  version: number;
  model: string;
  made_at: string;
  made_by: string;
  source: string;
  note: string;
  rolls_back_to: number;
  sha256: string;
  parameters: SetParameter[];
  messages?: TextMessages;
}

export interface WirePlacement {
  name: string;
  anchor_in_base_m: [number, number, number];
  hook_in_flange_m: [number, number, number];
}

export interface WorkPlace {
  in_base_m: [number, number, number];
  error_m: number;
  u_m: number;
}
