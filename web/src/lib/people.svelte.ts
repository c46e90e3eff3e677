// Who sits at this screen, and what that allows. The service decides; the page only does not offer what would be refused.

import { hearAnswers, post, prove, type Answer } from "./device";
import { come, early } from "./early";
import { language, type Key } from "./i18n.svelte";
import { learn } from "./messages";
import { sayings } from "./say.svelte";
import type { Person, Right, Role, SignInState } from "./sign_in_types";

hearAnswers(learn);

const CODES: Record<string, Key> = {
  offline: "people_offline",
  "people.wrong": "people_wrong",
  "people.sign_in": "people_unknown_device",
  "people.pin": "people_pin_again",
  "people.role": "people_not_allowed",
  "people.second_person": "people_second_what",
  "people.elsewhere": "control_elsewhere",
  "desk.stale": "control_stale",
  "desk.gone": "control_desk_gone",
  "desk.stop_unconfirmed": "control_stop_unconfirmed",
};

/** What an answer of the service means, in the page's language where the page knows it. */
export function inWords(answer: { code: string; message: string; remedy: string; waitS?: number }): string {
  const { t } = language;
  if (answer.code === "people.wait") return t("people_wait", { minutes: Math.ceil((answer.waitS ?? 60) / 60) });
  const key = CODES[answer.code];
  if (key) return t(key);
  // Each by itself: a message may have no stop, and would be one sentence with its remedy, which no catalogue has.
  const sentences = [answer.message, answer.remedy].filter(Boolean).flatMap(sayings.sentences);
  return sentences.map((part) => part.text).join(sayings.gap);
}

/** Whether an answer has words of the page for its code. */
export const isKnown = (answer: { code: string }): boolean => answer.code === "people.wait" || answer.code in CODES;

class People {
  wanted = $state<SignInState["wanted"] | null>(null); // null until the service has said
  person = $state<Person | null>(null);
  #first: typeof early | null = early; // asked while the page was still loading; later it would be old
  #turns: Promise<unknown> = Promise.resolve(); // what asks for or changes the session, one after the other
  /** Called when the session's cookie is a new one. */
  onNewSession: () => void = () => {};

  may(right: Right): boolean {
    return this.person?.rights.includes(right) ?? false;
  }

  take(standing: SignInState) {
    this.wanted = standing.wanted;
    this.person = standing.person;
  }

  /** Ask what is wanted; an enrolled device proves itself unasked. False when the service does not answer. */
  check(): Promise<boolean> {
    return this.#inTurn(() => this.#check());
  }

  async #check(): Promise<boolean> {
    try {
      const first = this.#first;
      this.#first = null;
      this.take((await first) ?? (await come()));
      return true;
    } catch {
      return false;
    }
  }

  /** Who may sign in here. */
  async listPeople(): Promise<{ name: string; role: Role }[]> {
    const answer = await fetch("./api/sign-in/people", { signal: AbortSignal.timeout(10_000) });
    if (!answer.ok) throw new Error(answer.statusText);
    return answer.json();
  }

  signIn(name: string, secret: string): Promise<Answer> {
    return this.#change(() => post("sign-in/person", { name, secret }));
  }

  leave(): Promise<Answer> {
    return this.#change(() => post("sign-in/leave", {}));
  }

  confirm(secret: string): Promise<Answer> {
    return this.#inTurn(async () => {
      const answer = await post("sign-in/confirm", { secret });
      if (answer.ok) await this.#check();
      return answer;
    });
  }

  /** Whether whoever sits here has a passphrase: the role that counts just now may be less, behind a lock. */
  async hasPassphrase(): Promise<boolean> {
    const listPeople = await this.listPeople().catch(() => []);
    const role = listPeople.find((each) => each.name === this.person?.name)?.role;
    return role === "engineer" || role === "admin";
  }

  /** Begin a session of this device's own, after it was enrolled. */
  comeInAsDevice(): Promise<void> {
    return this.#inTurn(async () => {
      if (!(await prove())) return;
      await this.#check();
      this.onNewSession();
    });
  }

  #change(ask: () => Promise<Answer>): Promise<Answer> {
    return this.#inTurn(async () => {
      const answer = await ask();
      if (answer.ok) {
        await this.#check();
        this.onNewSession();
      }
      return answer;
    });
  }

  /** A device that proves itself late would end the session that a person has begun meanwhile. */
  #inTurn<T>(act: () => Promise<T>): Promise<T> {
    const done = this.#turns.then(act);
    this.#turns = done.catch(() => undefined);
    return done;
  }
}

export const people = new People();
