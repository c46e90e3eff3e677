/** A tone and a shake when something was recorded or failed: chosen per tablet, off at first, never the only sign. */
import type { Session } from "./types";

const KEPT = "cue";
const TONES = { recorded: [880, 0.09], failed: [220, 0.35] } as const; // Hz and s
const SHAKES = { recorded: [40], failed: [120, 60, 120] } as const; // ms
export type Heard = keyof typeof TONES;

class Cue {
  on = $state(localStorage.getItem(KEPT) === "on");
  #context: AudioContext | null = null;

  /** Choose for this tablet; the press that switches it on also lets the browser sound, and lets it be heard. */
  choose(on: boolean) {
    this.on = on;
    if (on) localStorage.setItem(KEPT, "on");
    else localStorage.removeItem(KEPT);
    this.give("recorded");
  }

  give(what: Heard) {
    if (!this.on) return;
    navigator.vibrate?.([...SHAKES[what]]);
    if (!("AudioContext" in window)) return;
    this.#context ??= new AudioContext();
    void this.#context.resume();
    const [hertz, seconds] = TONES[what];
    const [tone, volume, now] = [this.#context.createOscillator(), this.#context.createGain(), this.#context.currentTime];
    tone.frequency.value = hertz;
    volume.gain.setValueAtTime(0.2, now);
    volume.gain.linearRampToValueAtTime(0, now + seconds); // cut off at once it would click
    tone.connect(volume).connect(this.#context.destination);
    tone.start(now);
    tone.stop(now + seconds);
  }
}

export const cue = new Cue();

/** Tell what became of a run between two looks at it; nothing where it is another run, or nothing weighs. */
export function cueFor(before: Session["run"], now: Session["run"]): Heard | null {
  if (before === null || now === null || (before.id && before.id !== now.id)) return null;
  const last = before.events[before.events.length - 1]?.n ?? 0;
  const failed = now.events.some((event) => event.n > last && event.kind === "failed");
  const ended = before.outcome === null && now.outcome !== null;
  if (failed || (ended && (now.outcome?.verdict !== "passed" || now.outcome.judgement?.word === "fail"))) return "failed";
  return now.found.length > before.found.length && before.does === "read" ? "recorded" : null;
}
