// What procedures say, in the language of the page: titles, steps, instructions, settings.
//
// The service says it in English; the words are the keys. A number in a sentence is a hole, "#", so that one entry
// does for every figure. A sentence without an entry is shown as it was said: better English than nothing.

import { language, type Locale } from "./i18n.svelte";

const FILES = import.meta.glob<Record<string, string>>("../locales/procedures/*.json", { import: "default" });
const NUMBER = /(?<![A-Za-z_\d.])[-+]?\d+(?:\.\d+)?/g;
const SENTENCE = /(?<=[.?!])\s+/;

class Sayings {
  #table = $state.raw<Record<string, string>>({});

  constructor() {
    $effect.root(() => {
      $effect(() => {
        void this.#load(language.locale);
      });
    });
  }

  /** A text of a procedure in the page's language. */
  say = (text: string): string => text.split(SENTENCE).map((part) => this.#one(part) ?? part).join(" ");

  /** The name of a step, whose number may be its own. */
  step = (given: string): string => {
    const name = given.replace(/,$/, ""); // of a phase whose steps are numbered after a comma
    const whole = this.#one(name);
    if (whole !== null) return whole;
    const under = name.indexOf(": ");
    if (under > 0) return `${this.step(name.slice(0, under))}: ${this.step(name.slice(under + 2))}`;
    const numbered = /^(.*?),? (\d+)$/.exec(name);
    return numbered ? `${this.step(numbered[1]!)} ${numbered[2]}` : name;
  };

  #one(text: string): string | null {
    const said = this.#table[text.replace(NUMBER, "#").trim()];
    if (said === undefined) return null;
    const numbers = text.match(NUMBER) ?? [];
    let next = 0;
    return said.replace(/#/g, () => this.#written(numbers[next++] ?? "#"));
  }

  #written(number: string): string {
    return language.locale === "de" || language.locale === "es" ? number.replace(".", ",") : number;
  }

  async #load(locale: Locale) {
    const file = FILES[`../locales/procedures/${locale}.json`];
    const table = file ? await file() : {};
    if (locale === language.locale) this.#table = table;
  }
}

export const sayings = new Sayings();
