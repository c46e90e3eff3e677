// What procedures, devices and refusals say, in the language of the page.
//
// The service says it in English; the words are the keys. A number in a procedure's sentence is a hole, "#", so that
// one entry does for every figure. A refusal's holes are numbered, "{1}", as they stand in the source: what fills one
// is said in the page's language, too, where it is known, and numbers are written as people write them there. A
// sentence without an entry is shown as it was said, and marked as English: better than nothing.

import { language, type Locale } from "./i18n.svelte";
import { later } from "./later";
import labels from "./setting_labels.json";

const FILES = import.meta.glob<Record<string, string>>("../locales/{procedures,settings,refusals}/*.json", { import: "default" });
const KINDS = ["procedures", "settings", "refusals"];
const SENTENCED = /\p{Ll} \p{Ll}/u; // a name is no reason to fetch what refusals say
const NUMBER = /(?<![A-Za-z_\d.])[-+]?\d+(?:\.\d+)?/g;
const ONLY_A_NUMBER = /^[-+]?\d+(?:\.\d+)?(?: ?(?:%|mm|m|deg|rad))?$/;
const SENTENCE = /(?<=[.?!])\s+/;
const STOPPED = /[.。?？!！]$/;
const WORD = /\p{L}{2}/u; // a name like "x" is the same everywhere
const HOLE = /\{(\d+)\}/;
// A device's trouble begins with its name, a message's with its key, a step's with its name and number.
const DEVICE = /^([\w/-]+(?: [\w-]+){0,2}|[\w ,/-]+ \d+): (.+)$/s;

// Names of settings in messages, which the terminal needs: a page says what they are called. An empty label is one of
// a name that stands for several settings: in brackets it is left out.
const LABELS: Record<string, string> = labels;
const NAMED = /( ?\()?\b(?:[a-z]+\.)*([a-z0-9]+(?:_[a-z0-9]+)+)\b(\))?/g;

/** A sentence, and whether it is still English on a page that is not. */
export interface Spoken {
  text: string;
  english: boolean;
}

interface Pattern {
  matches: RegExp;
  said: string;
  weight: number; // letters that are not holes: what says more is tried first
}

class Sayings {
  #table = $state.raw<Record<string, string>>({});
  #patterns: Pattern[] = [];
  #heard = new Map<string, string | null>();

  #known = { locale: "", kinds: 0 }; // what the table is of
  #wanted = 1; // of KINDS: every page names procedures; refusals come when one is told, or later

  constructor() {
    $effect.root(() => {
      $effect(() => {
        void this.#load(language.locale);
      });
    });
    this.#wantAll();
  }

  /** A text of a procedure, a device or a refusal in the page's language. */
  say = (text: string): string => this.parts(text).map((part) => part.text).join(this.gap);

  /** What stands between two sentences: nothing in Chinese. */
  get gap(): string {
    return language.locale === "zh" ? "" : " ";
  }

  /** The same, sentence by sentence. */
  parts = (text: string): Spoken[] => {
    const english = language.locale !== "en";
    if (text === "") return [];
    return text.split(SENTENCE).map((part) => {
      const said = this.#one(part);
      const text = this.#labelled(said ?? part);
      return { text, english: said === null && english && WORD.test(part) };
    });
  };

  /** The same as whole sentences, each with its capital and its stop, where they were parts of one. */
  sentences = (text: string): Spoken[] => this.parts(text).map((part) => ({ ...part, text: wholeSentence(part) }));

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

  #labelled(text: string): string {
    return text.replace(NAMED, (whole: string, before: string | undefined, name: string, after: string | undefined) => {
      const label = LABELS[name];
      if (label === undefined) return whole;
      if (label === "") return before && after ? "" : `${before ?? ""}${name.replaceAll("_", " ")}${after ?? ""}`;
      return `${before ?? ""}“${this.#one(label) ?? label}”${after ?? ""}`;
    });
  }

  #one(text: string): string | null {
    const table = this.#table; // read first: who asks is told when another language has come
    let said = this.#heard.get(text);
    if (said === undefined) {
      said = this.#counted(table, text) ?? this.#filled(text) ?? this.#ofDevice(text) ?? this.#listed(text);
      this.#heard.set(text, said);
      if (said === null && this.#wanted === 1 && SENTENCED.test(text)) this.#wantAll(0);
    }
    return said;
  }

  #counted(table: Record<string, string>, text: string): string | null {
    const said = table[text.trim()] ?? table[text.replace(NUMBER, "#").trim()];
    if (said === undefined) return null;
    const numbers = text.match(NUMBER) ?? [];
    let next = 0;
    return said.replace(/#/g, () => this.#written(numbers[next++] ?? "#"));
  }

  #filled(text: string): string | null {
    for (const { matches, said } of this.#patterns) {
      const found = matches.exec(text.trim());
      if (found) return said.replace(/\{(\d+)\}/g, (_, hole) => this.#value(found[Number(hole)] ?? ""));
    }
    return null;
  }

  #ofDevice(text: string): string | null {
    const found = DEVICE.exec(text);
    const said = found ? this.#one(found[2]!) : null;
    if (said === null) return null;
    return `${this.#name(found![1]!)}: ${said}`;
  }

  #listed(text: string): string | null {
    const cut = text.indexOf("; ");
    if (cut < 0) return null;
    const said = [text.slice(0, cut), text.slice(cut + 2)].map((part) => this.#one(part));
    return said.includes(null) ? null : said.join(this.#between);
  }

  #value(words: string): string {
    if (ONLY_A_NUMBER.test(words)) return this.#written(words);
    const parts = words.split("; ").map((part) => this.#one(part)); // a list: of names, or of a controller's own words and ours
    if (parts.length > 1 && parts.some((said) => said !== null) && this.#counted(this.#table, words) === null)
      return words.split("; ").map((part, place) => parts[place] ?? part).join(this.#between);
    return this.#one(words) ?? this.#name(words);
  }

  get #between(): string {
    return language.locale === "zh" ? "；" : "; ";
  }

  #name(words: string): string {
    return / \d+$/.test(words) ? this.step(words) : words; // a device has its own name
  }

  #written(number: string): string {
    return language.locale === "de" || language.locale === "es" ? number.replace(".", ",") : number;
  }

  #wantAll(wait_ms?: number) {
    later(() => {
      this.#wanted = KINDS.length;
      return this.#load(language.locale);
    }, wait_ms);
  }

  async #load(locale: Locale) {
    const kinds = KINDS.slice(0, this.#wanted);
    const files = kinds.map((kind) => FILES[`../locales/${kind}/${locale}.json`]);
    const tables = await Promise.all(files.map((file) => file?.() ?? {}));
    if (locale !== language.locale || (locale === this.#known.locale && kinds.length <= this.#known.kinds)) return;
    this.#known = { locale, kinds: kinds.length };
    const table = Object.assign({}, ...tables) as Record<string, string>;
    this.#patterns = Object.entries(table)
      .filter(([english]) => HOLE.test(english))
      .map(([english, said]) => pattern(english, said))
      .sort((one, other) => other.weight - one.weight);
    this.#heard.clear();
    this.#table = table;
  }
}

function wholeSentence({ text, english }: Spoken): string {
  const stop = language.locale === "zh" && !english ? "。" : ".";
  return text.replace(/^\p{Ll}/u, (letter) => letter.toUpperCase()) + (STOPPED.test(text) ? "" : stop);
}

function pattern(english: string, said: string): Pattern {
  const literals = english.split(/\{\d+\}/);
  const source = literals.map((part) => part.replace(/[.*+?^${}()|[\]\\]/g, "\\$&")).join("(.*?)");
  return { matches: new RegExp(`^${source}$`, "s"), said, weight: literals.join("").length };
}

export const sayings = new Sayings();
