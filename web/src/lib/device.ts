// This browser's own key: made when it is enrolled, never readable, kept in IndexedDB; its signature opens a session.

import type { Standing } from "./people.svelte";

const STORE = "device";
const WAIT_MS = 10_000;

interface Kept {
  id: string;
  key: CryptoKey;
}

export interface Answer {
  ok: boolean;
  code: string;
  message: string;
  remedy: string;
  waitS: number;
  told: Record<string, unknown>;
}

let passOnAnswer: (content: Record<string, unknown>) => void = () => {};

/** Let what is told be heard elsewhere, too. This script is loaded before all others, and may need none of them. */
export function hearAnswers(by: typeof passOnAnswer): void {
  passOnAnswer = by;
}

/** Send JSON to the service and tell what it answered; a link that is silent is an answer, too. */
export async function post(path: string, content: unknown, waitMs = WAIT_MS): Promise<Answer> {
  try {
    const answer = await fetch(`./api/${path}`, {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify(content),
      signal: AbortSignal.timeout(waitMs),
    });
    const told = (await answer.json()) as Record<string, string>;
    passOnAnswer(told);
    const { code = "", message = answer.statusText, remedy = "" } = told;
    return { ok: answer.ok, code, message, remedy, waitS: Number(answer.headers.get("retry-after") ?? 0), told };
  } catch {
    return { ok: false, code: "offline", message: "", remedy: "", waitS: 0, told: {} };
  }
}

/** Whether this browser can have a key at all: a page over plain http from another computer cannot. */
export const canEnrol = () => globalThis.crypto?.subtle !== undefined && "indexedDB" in globalThis;

/** Make a key, enrol its public half with the token of the address, and keep it. */
export async function enrol(token: string): Promise<Answer> {
  const pair = await crypto.subtle.generateKey({ name: "ECDSA", namedCurve: "P-256" }, false, ["sign", "verify"]);
  const spki = await crypto.subtle.exportKey("spki", pair.publicKey);
  const answer = await post("sign-in/devices", { token, public_key: url64(spki) });
  if (answer.ok) await keep({ id: String(answer.told.device), key: pair.privateKey });
  return answer;
}

/** Prove that this browser is the enrolled device; null when it has no key or the service does not know it. */
export async function prove(): Promise<Standing | null> {
  const kept = canEnrol() ? await read() : undefined;
  if (!kept) return null;
  const asked = await post("sign-in/challenges", {});
  if (!asked.ok) return null;
  const challenge = String(asked.told.challenge);
  const text = new TextEncoder().encode(`cellcal device sign-in\n${location.origin}\n${challenge}`);
  const signature = await crypto.subtle.sign({ name: "ECDSA", hash: "SHA-256" }, kept.key, text);
  const answer = await post("sign-in/device", { device: kept.id, challenge, signature: url64(signature) });
  return answer.ok ? (answer.told as unknown as Standing) : null;
}

function url64(bytes: ArrayBuffer): string {
  const text = btoa(String.fromCharCode(...new Uint8Array(bytes)));
  return text.replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
}

function store<T>(mode: IDBTransactionMode, ask: (store: IDBObjectStore) => IDBRequest<T>): Promise<T> {
  return new Promise((done, failed) => {
    const opening = indexedDB.open("cellcal", 1);
    opening.onupgradeneeded = () => opening.result.createObjectStore(STORE);
    opening.onerror = () => failed(opening.error);
    opening.onsuccess = () => {
      const asked = ask(opening.result.transaction(STORE, mode).objectStore(STORE));
      asked.onsuccess = () => done(asked.result);
      asked.onerror = () => failed(asked.error);
    };
  });
}

// One browser may be enrolled at several cells: each address has its own key.
const keep = (kept: Kept) => store("readwrite", (at) => at.put(kept, location.origin));
const read = () => store<Kept | undefined>("readonly", (at) => at.get(location.origin)).catch(() => undefined);
