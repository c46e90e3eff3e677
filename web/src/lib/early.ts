// Asked before the rest of the page is there: what this browser has to show to come in. An enrolled device whose session
// is over proves itself meanwhile; over a slow link that takes four round trips, as long as the page itself.

import { prove } from "./device";
import type { Standing } from "./people.svelte";

const WAIT_MS = 4000;

/** What is wanted of whoever sits here; an enrolled device has proved itself before it is told. */
export async function come(): Promise<Standing> {
  const standing = await look();
  return standing.wanted === "device" ? ((await prove()) ?? standing) : standing;
}

async function look(): Promise<Standing> {
  const answer = await fetch("./api/sign-in", { signal: AbortSignal.timeout(WAIT_MS) });
  if (!answer.ok) throw new Error(answer.statusText);
  return answer.json();
}

/** The first answer; a link that failed is no answer. */
export const early: Promise<Standing | null> = come().catch(() => null);
