// A job of the service, looked at until it has ended.

import { isOpen } from "./programs";
import { fetchJson, ServiceError } from "./review";

const LOOK_MS = 600;

/** Hand on how a job stands, again and again until it has ended; `onMissing`: the service does not know it. Return how to end this. */
export function followJob<T extends { state: string }>(path: string, onStatus: (job: T) => void, onMissing: () => void): () => void {
  let hasEnded = false;
  let next: ReturnType<typeof setTimeout> | undefined;
  const look = async () => {
    try {
      const found = await fetchJson<T>(path);
      if (hasEnded) return;
      onStatus(found);
      if (isOpen(found)) next = setTimeout(look, LOOK_MS);
    } catch (error) {
      if (hasEnded) return;
      if (error instanceof ServiceError) onMissing();
      else next = setTimeout(look, 3 * LOOK_MS); // no answer just now
    }
  };
  void look();
  return () => {
    hasEnded = true;
    clearTimeout(next);
  };
}
