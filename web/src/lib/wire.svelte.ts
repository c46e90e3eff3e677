// The line to the service. The server owns the run; this page only shows the newest session and sends orders.
//
// A link that falls silent is taken for lost after 2.2 s: a closed TCP connection may not be reported for minutes.
// A lost socket is dropped and its late events are ignored. An order that could not be sent waits, once, under its
// own id: sent again after the link is back it is obeyed once.

import type { ControlSeen as Control, RefusalResponse as Refusal } from "./api_types";
import { post } from "./device";
import { learn } from "./messages";
import { follow } from "./session_order";
import { people } from "./people.svelte";
import type { SignInState } from "./sign_in_types";
import type { Live, Order, Session, Trouble } from "./types";

const SILENT_MS = 2200; // a link that worked
const STOP_MS = 3000; // the service says after 2 s that the cell's process is silent
const TRY_MS = 1500; // a new one; each that is not answered gives the next one twice the time, as slow networks need
const LONGEST_TRY_MS = 6000;
const RETRY_MS = 300;
const UNKNOWN_MS = 2000; // a device that may not come in asks rarely
const LOOK_MS = 250;
const HOLD_MS = 100;
const TAP_MS = 400; // the second of two quick taps must not answer the question that the first one brought
const CAME_IN = "came-in"; // in this browser's memory: it was let in before
const QUEUED_MS = 30_000; // what could not be sent for longer is pressed again, by somebody who looks

export interface Pressed {
  id: string;
  rev: number;
  order: Order;
}

const FREE: Control = {
  mine: false,
  holder: null,
  asking: null,
  asking_mine: false,
  remaining_s: null,
  approved: "",
  approved_by: "",
};

class Wire {
  session = $state<Session | null>(null);
  live = $state<Live | null>(null);
  liveAtMs = $state(0);
  online = $state(false);
  wasOnline = $state(false); // this page had a link before
  nowMs = $state(Date.now());
  refusal = $state<Refusal | null>(null);
  waiting = $state<Pressed | null>(null);
  demo = $state(false);
  control = $state<Control>(FREE);
  wantsPin = $state<Pressed | null>(null); // what is sent again once the PIN is there
  wantsWord = $state<Pressed | null>(null); // the journal's end is missing: a person says whether to go on
  troubles = $state<Trouble[]>([]);
  wantsSecond = $state<Pressed | null>(null);

  #controlAtMs = $state(0);
  #dueRev = $state(0);
  #askedAtMs = $state(0);
  #socket: WebSocket | null = null;
  #opened = false;
  #begins = true; // no session was told by this line yet
  #turn = 0;
  #coming = false; // being asked who may come in
  #heardMs = 0;
  #tryMs = TRY_MS;
  #lookedMs = 0;
  #queuedMs = 0;
  #sending = false;
  #askedMs = 0;
  #beat = 0;
  #holding: ReturnType<typeof setInterval> | undefined;

  get person() {
    return people.person;
  }

  /** Whether somebody else's screen has the session in hand. */
  get elsewhere(): boolean {
    return this.control.holder !== null && !this.control.mine;
  }

  /** Whether this run goes on just now: its journal has no end, and is not broken off either. */
  goesOn(run_id: string): boolean {
    const run = this.session?.run;
    return run?.id === run_id && run.state !== "ended";
  }

  /** Whether an order (other than a stop) has a chance: the link, the role, the control, and none on its way. */
  get mayOrder(): boolean {
    return this.mayHold && this.#settled;
  }

  /** The same for the hold button, which an order on its way does not let go. */
  get mayHold(): boolean {
    return this.online && people.may("run") && !this.elsewhere;
  }

  /** Whether a yes counts: as an order, or as the second of two approvals, which any screen may give. */
  get mayApprove(): boolean {
    return this.mayAgreeTo(this.session?.prompt?.id);
  }

  /** The same for a yes to something that has a name: a question of the cell process, or a change that a page shows. */
  mayAgreeTo(question: string | undefined): boolean {
    return this.mayOrder || (this.online && this.#settled && people.may("run") && this.#awaitsMe(question));
  }

  /** Whether the question shown waits for this person's approval as the second. */
  get secondWanted(): boolean {
    return this.#awaitsMe(this.session?.prompt?.id);
  }

  #awaitsMe(question: string | undefined): boolean {
    const { approved, approved_by } = this.control;
    return approved !== "" && approved === question && approved_by !== people.person?.name;
  }

  get #settled(): boolean {
    if (this.nowMs - this.#askedAtMs < TAP_MS) return false;
    return this.waiting === null && (this.session?.rev ?? 0) >= this.#dueRev;
  }

  /** Seconds until a request to take over is granted. */
  get remainingS(): number {
    return Math.max(0, (this.control.remaining_s ?? 0) - (this.nowMs - this.#controlAtMs) / 1000);
  }

  start() {
    people.onNewSession = () => this.#reopen();
    if (localStorage.getItem(CAME_IN)) this.#open(); // most often it still may; asking first would cost a round trip
    void this.#comeIn();
    setInterval(() => this.#look(), LOOK_MS);
  }

  // Orders

  async order(order: Order): Promise<boolean> {
    if (!this.session) return false;
    const pressed = { id: randomId(), rev: this.session.rev, order };
    if (order.op === "stop") return this.#stop(pressed); // behind nothing else
    if (this.waiting) return false; // a second tap while the first is on its way
    this.waiting = pressed;
    this.refusal = null;
    this.#queuedMs = Date.now();
    return this.#send();
  }

  /** Send a stop; whatever keeps its answer away, the person is told that the robot may still move. */
  async #stop(pressed: Pressed): Promise<boolean> {
    const answer = await post("commands", pressed, STOP_MS);
    const unanswered = ["offline", "desk.gone", "guard.often"].includes(answer.code);
    return this.#answered(pressed, unanswered ? { ...answer, code: "desk.stop_unconfirmed" } : answer);
  }

  /** Send what waited for a PIN, as a new press of what was looked at then. */
  async again(pressed: Pressed): Promise<boolean> {
    if (this.waiting) return false;
    this.waiting = { ...pressed, id: randomId() };
    this.#queuedMs = Date.now();
    return this.#send();
  }

  /** Let a second person approve at this screen. */
  async second(pressed: Pressed, name: string, secret: string) {
    const answer = await post("commands/second", { pressed: { ...pressed, id: randomId() }, name, secret });
    if (answer.ok) this.#dueRev = Number(answer.content.rev);
    return answer;
  }

  async #send(): Promise<boolean> {
    const pressed = this.waiting;
    if (!pressed || this.#sending) return false;
    this.#sending = true;
    const answer = await post("commands", pressed, SILENT_MS);
    this.#sending = false;
    if (answer.code === "offline") return false; // it stays waiting; #look sends it when the link is back
    this.waiting = null;
    return this.#answered(pressed, answer);
  }

  #answered(pressed: Pressed, answer: Awaited<ReturnType<typeof post>>): boolean {
    if (answer.ok) {
      this.#dueRev = Number(answer.content.rev ?? 0);
      return true;
    }
    const { code, message, remedy, content } = answer;
    if (content.session) this.#show(content.session as Session);
    if (code === "people.pin") this.wantsPin = pressed;
    else if (code === "people.second_person") this.wantsSecond = pressed;
    else if (code === "store.end_missing") this.wantsWord = pressed;
    else this.refusal = { code: code || "error", message, remedy };
    if (code === "people.sign_in") void people.check();
    return false;
  }

  // Control

  async wish(what: "ask" | "withdraw" | "give" | "refuse") {
    const answer = await post("control", { do: what });
    if (answer.ok) return; // every screen is told what came of it
    if (answer.code === "people.pin") people.wanted = "pin";
    else if (answer.code !== "offline") this.refusal = answer;
  }

  #takeControl(control: Control) {
    this.control = control;
    this.#controlAtMs = this.nowMs = Date.now();
  }

  // Hold to move: said again and again while the button is held; silence lets go on the other side. Each word says
  // back the service's newest number: a word that a slow link delivers late counts for less, or for nothing.

  hold() {
    if (this.#holding) return;
    this.#beat = 0;
    this.#sayHeld();
    this.#holding = setInterval(() => this.#sayHeld(), HOLD_MS);
  }

  release() {
    clearInterval(this.#holding);
    this.#holding = undefined;
    this.#say({ op: "hold", held: false });
  }

  #sayHeld() {
    this.#say({ op: "hold", held: true, beat: this.#beat });
  }

  #hearBeat(beat: number) {
    const first = this.#beat === 0;
    this.#beat = beat;
    if (first && this.#holding) this.#sayHeld();
  }

  #say(message: object) {
    if (this.#socket?.readyState === WebSocket.OPEN) this.#socket.send(JSON.stringify(message));
  }

  // The link

  async #comeIn() {
    const turn = ++this.#turn;
    this.#coming = true;
    const answered = await people.check();
    if (turn !== this.#turn) return; // asked again meanwhile: the newer one opens the line
    this.#coming = false;
    if (!answered) setTimeout(() => void this.#comeIn(), RETRY_MS);
    else if (people.wanted === "device") {
      this.#forget();
      localStorage.removeItem(CAME_IN);
      setTimeout(() => void this.#comeIn(), UNKNOWN_MS);
    } else {
      void this.#ask();
      if (this.#socket === null) this.#open();
    }
  }

  #forget() {
    this.#forgetSession();
    this.control = FREE;
  }

  /** Show no session; the next one is of another process, whose numbers are not those of before. */
  #forgetSession() {
    this.session = this.live = null;
    this.#dueRev = 0;
  }

  #open() {
    const url = new URL("./api/screen", location.href);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    this.#socket?.close();
    const socket = new WebSocket(url);
    this.#socket = socket;
    this.#opened = false;
    this.#begins = true;
    this.#heardMs = Date.now();
    socket.onopen = () => {
      if (socket !== this.#socket) return;
      this.#opened = true;
      localStorage.setItem(CAME_IN, "1");
    };
    socket.onmessage = (event) => {
      if (socket === this.#socket) this.#take(learn(JSON.parse(event.data)));
    };
    socket.onclose = (event) => {
      if (socket !== this.#socket) return;
      if (event.code === 1000) this.#reopen(); // this session has ended; another may have begun
      else this.#drop(!this.#opened);
    };
  }

  #reopen() {
    const socket = this.#socket;
    this.#socket = null;
    socket?.close();
    void this.#comeIn();
  }

  #take(message: { kind: string; content: never }) {
    this.#heardMs = Date.now();
    this.#tryMs = TRY_MS;
    this.online = this.wasOnline = true;
    const { kind, content } = message;
    if (kind === "session") {
      this.#show(content as Session, this.#begins);
      this.#begins = false;
    } else if (kind === "live") {
      this.live = content;
      this.liveAtMs = Date.now();
    } else if (kind === "person") people.take(content as SignInState);
    else if (kind === "control") this.#takeControl(content);
    else if (kind === "troubles") this.troubles = content;
    else if (kind === "demo") this.demo = content;
    else if (kind === "beat") this.#hearBeat(content);
    else if (kind === "gone") this.#forgetSession();
  }

  #show(session: Session, begins = false) {
    const { takes, due } = follow(session.rev, this.session?.rev ?? null, this.#dueRev, begins);
    if (!takes) return; // it was under way for longer
    this.#dueRev = due;
    if (session.prompt && session.prompt.id !== this.session?.prompt?.id) this.#askedAtMs = this.nowMs = Date.now();
    this.session = session;
  }

  /** Try anew; ``refused``: somebody answered and did not open, so it is asked who may come in. */
  #drop(refused: boolean) {
    const socket = this.#socket;
    this.#socket = null;
    this.online = false;
    socket?.close();
    if (refused && this.#coming) return; // what is being asked already opens the next one
    setTimeout(() => (refused ? void this.#comeIn() : this.#open()), RETRY_MS);
  }

  #look() {
    this.nowMs = Date.now();
    const asleepMs = this.nowMs - this.#lookedMs - LOOK_MS;
    if (asleepMs > 1000) this.#heardMs += asleepMs; // it was this page that stood still, not the link
    this.#lookedMs = this.nowMs;
    if (this.nowMs - this.#heardMs > (this.online ? SILENT_MS : this.#tryMs)) this.#lose();
    if (this.waiting && this.nowMs - this.#queuedMs > QUEUED_MS) this.#giveUp();
    else if (this.online && this.waiting) void this.#send();
    if (this.online && this.control.asking_mine && this.remainingS === 0) this.#takeOver();
  }

  #lose() {
    if (!this.online && this.#socket) this.#tryMs = Math.min(2 * this.#tryMs, LONGEST_TRY_MS);
    if (this.#socket) this.#drop(false);
    else this.online = false;
  }

  #giveUp() {
    this.waiting = null;
    this.refusal = { code: "offline", message: "", remedy: "" };
  }

  #takeOver() {
    if (this.nowMs - this.#askedMs < 1000) return;
    this.#askedMs = this.nowMs;
    void this.wish("ask");
  }

  async #ask() {
    try {
      const answer = await fetch("./api/session", { signal: AbortSignal.timeout(SILENT_MS) });
      if (!answer.ok) return;
      const content = learn(await answer.json());
      this.demo = content.demo;
      if (content.session && !this.session) this.#show(content.session);
    } catch {
      setTimeout(() => void this.#ask(), RETRY_MS);
    }
  }
}

function randomId(): string {
  return Array.from(crypto.getRandomValues(new Uint8Array(12)), (byte) => byte.toString(16).padStart(2, "0")).join("");
}

export const wire = new Wire();
