// The job that a page of jobs shows: followed as long as the page shows it.
import { followJob } from "./job_following";

/** Follow the job with the id that `id` gives below the address `jobs`; "" is none. To be called while a page is made. */
export function openJobBelow<Found extends { state: string }>(jobs: string, id: () => string) {
  let found = $state.raw<Found | null>(null);
  let isMissing = $state(false);

  $effect(() => {
    found = null;
    isMissing = false;
    if (!id()) return;
    return followJob<Found>(`${jobs}/${encodeURIComponent(id())}`, (next) => (found = next), () => (isMissing = true));
  });

  return {
    get found() {
      return found;
    },
    set found(next: Found | null) {
      found = next;
    },
    get isMissing() {
      return isMissing;
    },
  };
}
