// What a page will want soon, and not for its first picture: a slow link has enough to carry until then.

const LATER_MS = 4000;
const AGAIN_MS = 10_000;

/** Load something once the page has had time to show itself; again where the link failed. */
export function later(load: () => Promise<unknown>, wait_ms = LATER_MS): void {
  setTimeout(() => void load().catch(() => later(load, AGAIN_MS)), wait_ms);
}
