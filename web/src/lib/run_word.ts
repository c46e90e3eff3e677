// What a run's end is called, in lists and comparisons.

import type { Key } from "./i18n.svelte";
import type { RunHead } from "./review";
import { wire } from "./wire.svelte";

/** What a run's end is called: its verdict, or that there is none yet. */
export function wordOf(head: RunHead): Key {
  if (head.state === "interrupted" && wire.goesOn(head.run_id)) return "verdict_running";
  return `verdict_${head.state === "passed" ? head.word || "passed" : head.state}` as Key;
}
