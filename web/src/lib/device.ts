// This browser's own key: made when it is enrolled, never readable, kept in IndexedDB; its signature opens a session.

import type { SignInState } from "./sign_in_types";

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
  content: Record<string, unknown>;
}

let passOnAnswer: (content: Record<string, unknown>) => void = () => {};

/** Let what is told be heard elsewhere, too. This script is loaded before all others, and may need none of them. */
export function hearAnswers(by: typeof passOnAnswer): void {
  passOnAnswer = by;
}

/** Ask, and ask again for so long where the service has had too many requests of this address.
 *
 * Tablets behind one address share its requests: at the change of shifts the page waits its turn by itself.
 */
export async function fetchInTurn(ask: () => Promise<Response>, waitMs: number): Promise<Response> {
  const endsMs = Date.now() + waitMs;
  for (;;) {
    const answer = await ask();
    const pauseMs = 1000 * Math.max(Number(answer.headers.get("retry-after") ?? 0), 1);
    if (answer.status !== 429 || Date.now() + pauseMs > endsMs) return answer;
    const { code } = await answer.clone().json().catch(() => ({}));
    if (code !== "guard.often") return answer; // a PIN that may not be guessed just now
    await new Promise((done) => setTimeout(done, pauseMs));
  }
}

/** Send JSON to the service and tell what it answered; a link that is silent is an answer, too. */
export async function post(path: string, content: unknown, waitMs = WAIT_MS): Promise<Answer> {
  const ask = () =>
    fetch(`./api/${path}`, {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify(content),
      signal: AbortSignal.timeout(waitMs),
    });
  try {
    const answer = await fetchInTurn(ask, waitMs);
    const reply = (await answer.json()) as Record<string, string>;
    passOnAnswer(reply);
    const { code = "", message = answer.statusText, remedy = "" } = reply;
    return { ok: answer.ok, code, message, remedy, waitS: Number(answer.headers.get("retry-after") ?? 0), content: reply };
  } catch {
    return { ok: false, code: "offline", message: "", remedy: "", waitS: 0, content: {} };
  }
}

/** Whether this browser can have a key at all: a page over plain http from another computer cannot. */
export const canEnrol = () => globalThis.crypto?.subtle !== undefined && "indexedDB" in globalThis;

/** Make a key, enrol its public half with the token of the address, and keep it. */
export async function enrol(token: string): Promise<Answer> {
  const pair = await crypto.subtle.generateKey({ name: "ECDSA", namedCurve: "P-256" }, false, ["sign", "verify"]);
  const spki = await crypto.subtle.exportKey("spki", pair.publicKey);
  const answer = await post("sign-in/devices", { token, public_key: url64(spki) });
  if (answer.ok) await storeKey({ id: String(answer.content.device), key: pair.privateKey });
  return answer;
}

/** Prove that this browser is the enrolled device; null when it has no key or the service does not know it. */
export async function prove(): Promise<SignInState | null> {
  const deviceKey = canEnrol() ? await read() : undefined;
  if (!deviceKey) return null;
  const challengeReply = await post("sign-in/challenges", {});
  if (!challengeReply.ok) return null;
  const challenge = String(challengeReply.content.challenge);
  const text = new TextEncoder().encode(`cellcal device sign-in\n${location.origin}\n${challenge}`);
  const signature = await crypto.subtle.sign({ name: "ECDSA", hash: "SHA-256" }, deviceKey.key, text);
  const answer = await post("sign-in/device", { device: deviceKey.id, challenge, signature: url64(signature) });
  return answer.ok ? (answer.content as unknown as SignInState) : null;
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
      const request = ask(opening.result.transaction(STORE, mode).objectStore(STORE));
      request.onsuccess = () => done(request.result);
      request.onerror = () => failed(request.error);
    };
  });
}

// One browser may be enrolled at several cells: each address has its own key.
const storeKey = (deviceKey: Kept) => store("readwrite", (at) => at.put(deviceKey, location.origin));
const read = () => store<Kept | undefined>("readonly", (at) => at.get(location.origin)).catch(() => undefined);
