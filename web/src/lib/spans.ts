// How long something takes, as people say it: seconds, minutes, and from two hours on hours.

import { language } from "./i18n.svelte";

const HOURS_FROM_S = 7200;

/** What a plan or a run is expected to take. */
export function lasting(seconds: number): string {
  const { t, number } = language;
  if (seconds >= HOURS_FROM_S) return t("duration_h", { hours: number(seconds / 3600, 1) });
  return t("duration", { minutes: number(Math.max(seconds / 60, 1), 0) });
}

/** What is left of a run. */
export function describeRemaining(seconds: number): string {
  const { t, number } = language;
  if (seconds >= HOURS_FROM_S) return t("step_left_h", { hours: number(seconds / 3600, 1) });
  return seconds < 90
    ? t("step_left_s", { seconds: number(Math.max(seconds, 1), 0) })
    : t("step_left_min", { minutes: number(seconds / 60, 0) });
}
