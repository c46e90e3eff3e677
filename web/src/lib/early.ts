// Asked before the rest of the page is there: what this browser has to show to come in. An enrolled device whose session
// is over proves itself meanwhile; over a slow link that takes four round trips, as long as the page itself.

import { prove } from "./device";
import type { SignInState } from "./sign_in_types";

const WAIT_MS = 4000;

/** What is wanted of whoever sits here; an enrolled device has proved itself before it is told. */
export async function come(): Promise<SignInState> {
  const standing = await look();
  return standing.wanted === "device" ? ((await prove()) ?? standing) : standing;
}

async function look(): Promise<SignInState> {
  const answer = await fetch("./api/sign-in", { signal: AbortSignal.timeout(WAIT_MS) });
  if (!answer.ok) throw new Error(answer.statusText);
  return answer.json();
}

/** The first answer; a link that failed is no answer. */
export const early: Promise<SignInState | null> = come().catch(() => null);
