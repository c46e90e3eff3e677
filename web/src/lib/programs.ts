// Programs that are made: what can be asked for, and what the service tells of it. Numbers are SI.

import type { JobPreview, ProgramsJob, ProgramsOverview, UploadedFile as Carried } from "./api_types";

export type {
  PointPreview as PointMade, PointsPage as PointsMade, PointsPicture as Picture, UploadedFile as Carried,
} from "./api_types";

export type Do = "compensate" | "download" | "move" | "clone";
export type Verdict = "fits" | "reach" | "limit" | "singular" | "flip" | "collision" | "unknown";
export type Job = ProgramsJob & { do: Do };
export type Bench = Required<Omit<ProgramsOverview, "jobs">> & { jobs: Job[] };
export type Preview = JobPreview & {
  counts: { changed: number; unchanged: number; left: number };
  verdicts: Record<Verdict, number>;
};

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
