// Robots identified from files of measurements: what the service tells of it. Numbers are SI.

import type * as Api from "./api_types";

export type Identification = Api.IdentifyJobWithResult;
export type Found = Api.IdentifyResult;

/** What a column may be, and how many columns of a file are it. */
export const MEANINGS = [
  ["joints", 8], ["position", 3], ["length", 1], ["rotation", 4], ["controller", 3], ["group", 1],
] as const;
export type Meaning = (typeof MEANINGS)[number][0];
export const MEASURED_ENDINGS = ".csv,.txt,.tsv,.dat,.xlsx,.xls,.ods";
export const LAYOUT_ENDINGS = ".toml";

export interface ErrorSummary {
  n: number;
  rmse_m: number;
  mean_m: number;
  p95_m: number;
  max_m: number;
}

/** The parts of a report (`cellcal identify --json`) that the page shows. */
export interface Report {
  rows: number;
  usable: number;
  level: number;
  level_name: string;
  before: ErrorSummary;
  fit: ErrorSummary;
  held_out: ErrorSummary;
  before_described: ErrorSummary | null; // of the same rows
  held_out_described: ErrorSummary | null; // without the rows put aside, if there are any
  check: ErrorSummary | null; // of another file
  held_out_by: string;
  rejected: { row: number; reason: string }[];
  level_reasons: string[];
  break_reasons: string[];
  breaks: number[];
  lints: { code: string; message: string }[];
  guesses: string[];
  group_effect: { said: string };
}

export const reportOf = (found: Found): Report => found.report as unknown as Report;

/** The errors that count first: of the rows that the model describes, by the nominal and by the identified robot. */
export const describedErrors = (report: Report): { before: ErrorSummary; after: ErrorSummary } => ({
  before: report.before_described ?? report.before,
  after: report.held_out_described ?? report.held_out,
});

/** The parts of the report of several readings that the page shows. */
export interface CellReport {
  level: number;
  level_name: string;
  level_reasons: string[];
  group_effects: string[];
  rejected: { series: string; line: number; reason: string }[];
}

export const cellReportOf = (found: Found): CellReport => found.report as unknown as CellReport;

/** What an approval of saving is named by; the service asks with the same words. */
export const saveQuestion = (job: Identification): string =>
  `${job.serial}: identification ${job.id} after version ${job.newest_version}`;
