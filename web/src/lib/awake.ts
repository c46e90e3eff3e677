// The screen stays on while a run goes on: nobody with gloves on wakes a tablet to ask for a stop.
//
// The browser lets go by itself when the page is hidden, so it is asked anew when the page is seen again. Where there
// is no such thing (no TLS, an old browser) or it is refused (an empty battery), the page works as before.

class Awake {
  #mustStayOn = false;
  #asking = false;
  #lock: WakeLockSentinel | null = null;

  start() {
    document.addEventListener("visibilitychange", () => void this.#look());
  }

  /** Keep the screen on, or let it sleep. */
  keep(mustStayOn: boolean) {
    this.#mustStayOn = mustStayOn;
    void this.#look();
  }

  async #look() {
    if (!navigator.wakeLock || this.#asking) return;
    this.#asking = true;
    const mustStayOn = this.#mustStayOn;
    try {
      if (!mustStayOn) await this.#lock?.release();
      else if (!document.hidden && (this.#lock?.released ?? true)) this.#lock = await navigator.wakeLock.request("screen");
    } catch {
      // asked again when the page is seen again
    }
    this.#asking = false;
    if (this.#mustStayOn !== mustStayOn) void this.#look(); // it began or ended meanwhile
  }
}

export const awake = new Awake();
