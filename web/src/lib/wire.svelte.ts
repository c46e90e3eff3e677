// The line to the service. The server owns the run; this page only shows the newest session and sends orders.
//
// A link that falls silent is taken for lost after 2.5 s: a closed TCP connection may not be reported for minutes.
// A lost socket is dropped and its late events are ignored. An order that could not be sent waits, once, under its
// own id: sent again after the link is back it is obeyed once.

import type { Live, Order, Session } from "./types";

const SILENT_MS = 2500;
const RETRY_MS = 700;
const HOLD_MS = 150;

export interface Refusal {
  code: string;
  message: string;
  remedy: string;
}

interface Waiting {
  id: string;
  rev: number;
  order: Order;
}

class Wire {
  session = $state<Session | null>(null);
  live = $state<Live | null>(null);
  liveAtMs = $state(0);
  online = $state(false);
  nowMs = $state(Date.now());
  refusal = $state<Refusal | null>(null);
  waiting = $state<Waiting | null>(null);
  person = $state<{ name: string; role: string } | null>(null);
  demo = $state(false);

  #socket: WebSocket | null = null;
  #heardMs = 0;
  #holding: ReturnType<typeof setInterval> | undefined;

  start() {
    void this.#ask();
    this.#open();
    setInterval(() => this.#look(), 250);
  }

  // Orders

  async order(order: Order): Promise<boolean> {
    if (this.waiting || !this.session) return false; // a second tap while the first is on its way
    this.waiting = { id: crypto.randomUUID?.() ?? randomId(), rev: this.session.rev, order };
    this.refusal = null;
    return this.#send();
  }

  async #send(): Promise<boolean> {
    const waiting = this.waiting;
    if (!waiting) return false;
    try {
      const answer = await fetch("./api/commands", {
        method: "POST",
        headers: { "Content-Type": "application/json" },
        body: JSON.stringify(waiting),
        signal: AbortSignal.timeout(SILENT_MS),
      });
      const told = await answer.json();
      this.waiting = null;
      if (answer.ok) return true;
      if (told.session) this.session = told.session;
      this.refusal = { code: told.code ?? "error", message: told.message ?? answer.statusText, remedy: told.remedy ?? "" };
      return false;
    } catch {
      return false; // it stays waiting; #look sends it again when the link is back
    }
  }

  // Hold to move: said again and again while the button is held; silence lets go on the other side.

  hold() {
    if (this.#holding) return;
    const say = () => this.#say({ op: "hold", held: true });
    say();
    this.#holding = setInterval(say, HOLD_MS);
  }

  release() {
    clearInterval(this.#holding);
    this.#holding = undefined;
    this.#say({ op: "hold", held: false });
  }

  #say(message: object) {
    if (this.#socket?.readyState === WebSocket.OPEN) this.#socket.send(JSON.stringify(message));
  }

  // The link

  #open() {
    const url = new URL("./api/screen", location.href);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(url);
    this.#socket = socket;
    this.#heardMs = Date.now();
    socket.onmessage = (event) => {
      if (socket === this.#socket) this.#take(JSON.parse(event.data));
    };
    socket.onclose = () => {
      if (socket === this.#socket) this.#drop();
    };
  }

  #take(message: { kind: string; content: never }) {
    this.#heardMs = Date.now();
    this.online = true;
    if (message.kind === "session") {
      const session = message.content as Session;
      if (!this.session || session.rev >= this.session.rev) this.session = session;
    } else if (message.kind === "live") {
      this.live = message.content;
      this.liveAtMs = Date.now();
    } else if (message.kind === "gone") {
      this.session = null;
      this.live = null;
    }
  }

  #drop() {
    const socket = this.#socket;
    this.#socket = null;
    this.online = false;
    socket?.close();
    setTimeout(() => this.#open(), RETRY_MS);
  }

  #look() {
    this.nowMs = Date.now();
    if (this.#socket && this.nowMs - this.#heardMs > SILENT_MS) this.#drop();
    if (this.online && this.waiting && !this.#resending) void this.#resend();
  }

  #resending = false;
  async #resend() {
    this.#resending = true;
    const waiting = this.waiting;
    await new Promise((done) => setTimeout(done, SILENT_MS / 2));
    if (waiting && waiting === this.waiting) await this.#send();
    this.#resending = false;
  }

  async #ask() {
    try {
      const told = await (await fetch("./api/session")).json();
      this.person = told.person;
      this.demo = told.demo;
      if (told.session && !this.session) this.session = told.session;
    } catch {
      setTimeout(() => void this.#ask(), RETRY_MS);
    }
  }
}

function randomId(): string {
  return Array.from(crypto.getRandomValues(new Uint8Array(12)), (byte) => byte.toString(16).padStart(2, "0")).join("");
}

export const wire = new Wire();
