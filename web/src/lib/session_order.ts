// Which of two sessions is the newer one. Each has a number that grows, and begins from the service's clock: where that
// was set back and the service started anew, the newest session has a lower number than the one that a page shows.

export interface Followed {
  takes: boolean; // the session that was told is shown from now on
  due: number; // the number that the page waits for after its last order
}

/** What becomes of a session that was told; ``begins`` where it is the first of a line: no older one comes by it. */
export function follow(told: number, shown: number | null, due: number, begins: boolean): Followed {
  const wentBack = shown !== null && told < shown;
  return { takes: begins || !wentBack, due: begins && wentBack ? 0 : due };
}
