// The line to the monitor: it tells what changed, and this page only shows it. There is nothing to send.
//
// A monitor that says nothing for 3 s is taken for lost: a closed connection may not be reported for minutes. A first
// word may take longer on a slow network: each try that is not answered gives the next one twice the time.

import { SvelteMap } from "svelte/reactivity";
import { learn } from "./messages";

const SILENT_MS = 3000;
const LOOK_MS = 250;
const RETRY_MS = 1000;
const LONGEST_TRY_MS = 12_000;
export const SKEW_S = 5; // a clock that is off by more is shown

export interface FleetAlarm {
  id: string;
  code: string;
  source: string;
  text: string;
  remedy: string;
}

export interface FleetRow {
  cell: string;
  name: string;
  link: "online" | "silent" | "offline" | "never";
  alarms: FleetAlarm[];
  run: { procedure: string; title: string; state: string; step: string; index: number; expected: number; verdict: string | null } | null;
  asks: { key: string; step: string } | null;
  attended: boolean;
  drift: { ended_utc: string; change_rms_m: number; word: string }[];
  certificate: { run_id: string; procedure: string; word: string; ended_utc: string } | null;
  due: { what: string; due: string }[];
  events: { have: number; known: number; lost: number };
  clock_off_s: number;
}

interface FleetUpdate {
  site: string;
  router: boolean;
  cells: number;
  ages: Record<string, number>;
  not_believed: { wall: string; cell: string; what: string }[];
  rows: FleetRow[];
}

/** Whether something of a cell is past the day it was due; days of the service are of UTC. */
export const isOverdue = (row: FleetRow, today: string): boolean => row.due[0] !== undefined && row.due[0].due < today;

/** Whether a person should look at a cell: something is wrong, waits, is late or was never there. */
export const needsLook = (row: FleetRow, today: string): boolean =>
  row.link !== "online" ||
  row.alarms.length > 0 ||
  row.asks !== null ||
  row.events.lost > 0 ||
  Math.abs(row.clock_off_s) >= SKEW_S ||
  isOverdue(row, today);

class FleetLine {
  rows = new SvelteMap<string, FleetRow>();
  site = $state("");
  router = $state(true);
  heard = $state(false);
  lost = $state(false); // not heard any more, or not at the first try: a page that has just opened has lost nothing
  signedIn = $state(true);
  today = $state(new Date().toISOString().slice(0, 10)); // a page in a control room stays open for months
  ages = $state.raw<Record<string, number>>({});
  notBelieved = $state.raw<FleetUpdate["not_believed"]>([]);

  #socket: WebSocket | null = null;
  #heardMs = 0;
  #triedMs = 0;
  #tryMs = SILENT_MS;

  start() {
    this.#open();
    setInterval(() => this.#look(), LOOK_MS);
  }

  #open() {
    this.#triedMs = Date.now();
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/fleet/live`);
    this.#socket = socket;
    socket.onmessage = (event) => {
      if (this.#socket === socket) this.#take(JSON.parse(event.data as string) as FleetUpdate);
    };
    socket.onclose = () => {
      if (this.#socket === socket) void this.#closed();
    };
  }

  #take(update: FleetUpdate) {
    this.#heardMs = Date.now();
    this.#tryMs = SILENT_MS;
    this.heard = this.signedIn = true;
    this.lost = false;
    learn(update);
    this.site = update.site;
    this.router = update.router;
    for (const row of learn(update.rows)) this.rows.set(row.cell, row);
    if (!same(this.ages, update.ages)) this.ages = update.ages;
    if (!same(this.notBelieved, update.not_believed)) this.notBelieved = update.not_believed;
  }

  async #closed() {
    this.#lose();
    try {
      this.signedIn = (await fetch("/api/fleet")).status !== 401;
    } catch {
      return; // the monitor is not there: it is tried again
    }
  }

  #lose() {
    this.heard = false;
    this.lost = true;
    this.#socket = null;
  }

  #look() {
    const now = Date.now();
    this.today = new Date(now).toISOString().slice(0, 10);
    const silentMs = now - Math.max(this.#heardMs, this.#triedMs);
    if (this.#socket !== null && silentMs > (this.heard ? SILENT_MS : this.#tryMs)) {
      if (!this.heard) this.#tryMs = Math.min(2 * this.#tryMs, LONGEST_TRY_MS);
      const lost = this.#socket;
      this.#lose();
      lost.close();
    }
    if (this.#socket === null && this.signedIn && now - this.#triedMs > RETRY_MS) this.#open();
  }
}

function same(a: unknown, b: unknown): boolean {
  return JSON.stringify(a) === JSON.stringify(b);
}

export const fleet = new FleetLine();
