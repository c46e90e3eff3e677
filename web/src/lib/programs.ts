// Programs that are made: what can be asked for, and what the service tells of it. Numbers are SI.

export type Do = "compensate" | "download" | "move" | "clone";
export type Verdict = "fits" | "reach" | "limit" | "singular" | "flip" | "collision" | "unknown";
type Triple = [number, number, number];

export interface Carried {
  name: string;
  content_base64: string;
}

export interface Bench {
  robots: { robot: string; serial: string; model: string; version: number | null; tools: string[]; frames: string[] }[];
  projects: { name: string; serial: string; master: string; programs: number; readable: boolean }[];
  jobs: Job[];
  most_files: number;
  most_bytes: number;
}

export interface Job {
  id: string;
  do: Do;
  who: string;
  at_utc: string;
  state: "waiting" | "running" | "done" | "failed" | "stopped";
  done: number;
  total: number;
  fault: { message: string; remedy: string } | null;
}

export interface Picture {
  in_base: boolean;
  points: { place_m: Triple; step: number; left: boolean; label: string }[];
  colours: string[];
  edges_m: number[];
  not_drawn: number;
}

export interface Preview {
  title: string;
  cell: string;
  parameters: string;
  counts: { changed: number; unchanged: number; left: number };
  verdicts: Record<Verdict, number>;
  collisions_checked: boolean;
  largest_shift_m: number | null;
  largest_expected_m: number | null;
  largest_uncorrected_m: number | null;
  programs: {
    program: string;
    file: string;
    brand: string;
    points: number;
    changed: number;
    unchanged: number;
    left: number;
    largest_shift_m: number | null;
    largest_expected_m: number | null;
  }[];
  refused: { file: string; line: number; column: number; message: string; remedy: string }[];
  notes: string[];
  page_size: number;
  picture: Picture;
}

export interface PointMade {
  program: string;
  point: string;
  line: number;
  verdict: Verdict;
  reason: string;
  changed: boolean;
  shift_m: number | null;
  turn_rad: number | null;
  expected_m: number | null;
  before_m: Triple | null;
  after_m: Triple | null;
  configuration_before: string;
  configuration_after: string;
}

export interface PointsMade {
  total: number;
  pages: number;
  points: PointMade[];
}

export const VERDICTS: Verdict[] = ["fits", "flip", "reach", "limit", "singular", "collision", "unknown"];
/** A shape for each verdict: colour says nothing that it does not. */
export const SIGN: Record<Verdict, string> = {
  fits: "✓",
  flip: "↺",
  reach: "✗",
  limit: "▲",
  singular: "◆",
  collision: "■",
  unknown: "?",
};
export const isOpen = (job: { state: string }): boolean => job.state === "waiting" || job.state === "running";

/** Pack a file as it is sent. */
export function packed(file: File): Promise<Carried> {
  return new Promise((resolve, reject) => {
    const reader = new FileReader();
    reader.onerror = () => reject(reader.error ?? new Error(file.name));
    reader.onload = () => {
      const text = String(reader.result);
      resolve({ name: file.name, content_base64: text.slice(text.indexOf(",") + 1) });
    };
    reader.readAsDataURL(file);
  });
}
