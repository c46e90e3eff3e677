// What procedures, devices and refusals say, in the language of the page.
//
// The service says it in English, and sends the template and the arguments of every text that has arguments
// (messages.ts). A catalogue has templates as its keys, sentence by sentence; a text without arguments is its own
// template; a built catalogue has short names of templates as its keys (table_keys.ts). What fills a hole is said in
// the page's language, too, and numbers are written as people write them there.
// A sentence without an entry is shown as it was said, and marked as English: better than nothing.
// service/translation.py has the same rules for what is made without a page.

import { shortenHashes } from "./hashes";
import { language, type Key, type Locale } from "./i18n.svelte";
import { later } from "./later";
import { english, escaped, fill, isPunctuation, messageOf, type Argument, type Message } from "./messages";
import titles from "./procedure_titles.json";
import labels from "./setting_labels.json";
import { tableKey } from "./table_keys";

const FILES = import.meta.glob<Record<string, string>>("../locales/{procedures,settings,refusals}/*.json", { import: "default" });
const KINDS = ["procedures", "settings", "refusals"];
const SENTENCED = /\p{Ll} \p{Ll}/u; // a name is no reason to fetch what refusals say
const SENTENCE = /(?<=[.?!])\s+/;
const STOPPED = /[.。?？!！]$/;
const BEGINNING = /^\p{Ll}(?!\S*[._\d]\S)/u; // of a sentence; a file's name stays as it is
const CHINESE_MARK = /^[，；：、。（]/; // has no space before it
const WORD = /\p{L}{2}/u; // a name like "x" is the same everywhere
const UNITS = ["", "%", "mm", "m", "deg", "rad"];
const LISTED = /(?:^|\s)\d+,$/; // before the last of several numbers: a list, and no step
const NAMES = /^[A-Za-z][\w.]*(?:, [A-Za-z][\w.]*)+$/; // "A2, A5": no more than names
const LEAD = /^(?:\{\w+\}\s*)+/; // of a template: what is filled in before its first word

// Names of settings and procedures in messages, which the terminal needs: a page says what they are called. An empty
// label is one of a name that stands for several settings: in brackets it is left out.
const LABELS: Record<string, string> = { ...titles, ...labels };
const NAMED = /( ?\()?\b(?:[a-z]+\.)*([a-z0-9]+(?:_[a-z0-9]+)+)\b(\))?/g;

// Options of the terminal in a remedy, as the page calls the same choice; one without a place on a page stays.
const CHOICES: Record<string, Key> = {
  robot: "meas_robot",
  columns: "meas_columns",
  "units joints": "meas_unit_joints",
  "units position": "meas_unit_position",
  "units length": "meas_unit_length",
  convention: "meas_convention",
  "joint-coupling": "meas_coupling",
  level: "meas_level",
  layout: "meas_layout_choose",
  "show-layout": "meas_show_reasons",
  check: "meas_check_choose",
  sheet: "file_sheet",
};
const OPTION = /`--([a-z-]+)(?: ([^`]+))?`|(?<=\s)--(robot)\b/g;
// What is left for a terminal is said with where that is, once in a sentence; other code stands in quotes, too.
const COMMAND = /`(cellcal [^`]+|--[^`]+)`/g;
const CODE = /`([^`]+)`/g;

/** A sentence, and whether it is still English on a page that is not. */
export interface Spoken {
  text: string;
  english: boolean;
}

interface Part {
  text: string;
  said: boolean; // in the page's language
}

class Sayings {
  #table = $state.raw<Record<string, string>>({});
  #partsByText = new Map<string, Part[]>();

  #loaded = { locale: "", kinds: 0 }; // what the table is of
  #requestedKinds = 1; // of KINDS: every page names procedures; refusals come when one is told, or later

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

  /** What stands between a name and what is said of it. */
  get colon(): string {
    return language.locale === "zh" ? "：" : ": ";
  }

  /** A text of the page with the full stop of its language; what has one, or another mark, keeps it. */
  stopped = (text: string): string => text + (STOPPED.test(text) ? "" : language.locale === "zh" ? "。" : ".");

  /** Sentences one after the other, each with its stop. */
  joined = (...texts: string[]): string => texts.map(this.stopped).join(this.gap);

  /** Names or figures one after the other. */
  listed = (...texts: string[]): string => texts.join(language.locale === "zh" ? "、" : ", ");

  /** Texts beside each other that have their own stops. */
  beside = (...texts: string[]): string => texts.filter((text) => text !== "").join(this.gap);

  /** The same, sentence by sentence. */
  parts = (text: string): Spoken[] =>
    this.#parts(text).map((part) => ({ text: this.#labelled(part.text), english: this.#isEnglish(part) }));

  /** The same as whole sentences, each with its capital and its stop, where they were parts of one. */
  sentences = (text: string): Spoken[] => this.parts(text).map((part) => ({ ...part, text: wholeSentence(part) }));

  /** The name of a step, `phase: name`, with a number behind either. */
  step = (fullName: string): string => {
    const name = fullName.replace(/,$/, ""); // of a phase whose steps are numbered after a comma
    const whole = this.#text(name);
    if (whole !== null) return whole;
    const under = name.indexOf(": ");
    if (under > 0) return `${this.step(name.slice(0, under))}${this.colon}${this.step(name.slice(under + 2))}`;
    const cut = name.lastIndexOf(" ");
    if (cut <= 0 || !isCount(name.slice(cut + 1))) return name;
    if (LISTED.test(name.slice(0, cut))) return fullName;
    const [base, count] = [this.step(name.slice(0, cut)), name.slice(cut + 1)];
    return /\d$/.test(base) ? `${base} (${count})` : `${base} ${count}`; // of "J1", the second time
  };

  #labelled(text: string): string {
    return shortenHashes(this.#withCommands(this.#withChoices(text))).replace(NAMED, (whole: string, before: string | undefined, name: string, after: string | undefined) => {
      const label = LABELS[name];
      if (label === undefined) return whole;
      if (label === "") return before && after ? "" : `${before ?? ""}${name.replaceAll("_", " ")}${after ?? ""}`;
      return `${before ?? ""}“${this.#text(label) ?? label}”${after ?? ""}`;
    });
  }

  #withChoices(text: string): string {
    return text.replace(OPTION, (whole: string, option: string | undefined, value: string | undefined, bare: string | undefined) => {
      const [meaning, unit] = option === "units" ? (value ?? "").split("=") : [];
      const choice = CHOICES[meaning === undefined ? (option ?? bare ?? "") : `units ${meaning}`];
      if (choice === undefined) return whole;
      const shownValue = meaning === undefined ? value : unit;
      return `“${language.t(choice).replaceAll("{n}", "…")}”${shownValue ? `${this.colon}${shownValue}` : ""}`;
    });
  }

  #withCommands(text: string): string {
    if (!text.includes("`")) return text;
    let placed = language.t("service_computer").split("|").some((words) => text.includes(words));
    const where = language.locale === "zh" ? `（${language.t("in_terminal")}）` : ` (${language.t("in_terminal")})`;
    const inTerminal = (_: string, command: string) => {
      const place = placed ? "" : where;
      placed = true;
      return `“${command}”${place}`;
    };
    return text.replace(COMMAND, inTerminal).replace(CODE, "“$1”");
  }

  #isEnglish(part: Part): boolean {
    return !part.said && language.locale !== "en" && WORD.test(part.text);
  }

  #parts(text: string): Part[] {
    if (text === "") return [];
    const table = this.#table; // read first: who asks is told when another language has come
    let parts = this.#partsByText.get(text);
    if (parts) return parts;
    parts = this.#partsIn(table, text);
    if (parts.every((part) => part.said)) this.#partsByText.set(text, parts);
    else if (this.#requestedKinds === 1 && SENTENCED.test(text)) this.#wantAll(0);
    return parts;
  }

  #partsIn(table: Record<string, string>, text: string): Part[] {
    const translation = table[tableKey(escaped(text.trim()))];
    if (translation !== undefined) return [{ text: fill(translation, String), said: true }];
    const message = messageOf(text);
    if (message) return this.#partsOf(message);
    const sentences = text.split(SENTENCE);
    return sentences.length === 1 ? [{ text, said: false }] : sentences.flatMap((sentence) => this.#parts(sentence));
  }

  #partsOf(message: Message): Part[] {
    return message.template.split(SENTENCE).map((template) => {
      const translation = this.#sentence(template, message);
      return { text: translation ?? english({ ...message, template }), said: translation !== null };
    });
  }

  /** A text of which a part has an entry. */
  #text(text: string): string | null {
    return this.#joined(this.#parts(text));
  }

  #joined(parts: Part[]): string | null {
    return parts.some((part) => part.said) ? parts.map((part) => part.text).join(this.gap) : null;
  }

  #sentence(template: string, message: Message): string | null {
    const translation = this.#found(template);
    if (translation === null) return null;
    let hasTranslation = !isPunctuation(template);
    const text = fill(translation, (name) => {
      const argument = message.arguments[name] ?? "";
      const value = this.#value(argument);
      hasTranslation ||= value !== null;
      const text = english(argument);
      return value ?? (NAMES.test(text) ? this.listed(...text.split(", ")) : this.step(text)); // a device has its own name
    });
    return hasTranslation ? text : null;
  }

  #found(template: string): string | null {
    const translation = this.#table[tableKey(template.trim())];
    if (translation !== undefined) return translation;
    if (isPunctuation(template)) return language.locale === "zh" ? template.replaceAll("; ", "；").replaceAll(", ", "、").replace(/\}\.$/, "}。") : template;
    const lead = LEAD.exec(template)?.[0] ?? "";
    const rest = lead === "" ? undefined : this.#table[tableKey(template.slice(lead.length))];
    return rest === undefined ? null : `${lead.trim()} ${rest}`;
  }

  #value(argument: Argument): string | null {
    if (typeof argument !== "string") return withSpacesOf(english(argument), this.#joined(this.#partsOf(argument)));
    return isNumber(argument) ? this.#written(argument) : withSpacesOf(argument, this.#text(argument));
  }

  #written(number: string): string {
    return language.locale === "de" || language.locale === "es" ? number.replace(".", ",") : number;
  }

  #wantAll(wait_ms?: number) {
    later(() => {
      this.#requestedKinds = KINDS.length;
      return this.#load(language.locale);
    }, wait_ms);
  }

  async #load(locale: Locale) {
    const kinds = KINDS.slice(0, this.#requestedKinds);
    const files = kinds.map((kind) => FILES[`../locales/${kind}/${locale}.json`]);
    const tables = await Promise.all(files.map((file) => file?.() ?? {}));
    if (locale !== language.locale || (locale === this.#loaded.locale && kinds.length <= this.#loaded.kinds)) return;
    this.#loaded = { locale, kinds: kinds.length };
    this.#partsByText.clear();
    this.#table = Object.assign({}, ...tables) as Record<string, string>;
  }
}

function wholeSentence({ text, english }: Spoken): string {
  const stop = language.locale === "zh" && !english ? "。" : ".";
  return text.replace(BEGINNING, (letter) => letter.toUpperCase()) + (STOPPED.test(text) ? "" : stop);
}

/** A translation with the spaces around the English text, which may be a part of another; Chinese ends in none. */
const withSpacesOf = (text: string, translated: string | null): string | null =>
  translated === null
    ? null
    : `${text.startsWith(" ") && !CHINESE_MARK.test(translated.trim()) ? " " : ""}${translated.trim()}${text.endsWith(" ") && language.locale !== "zh" ? " " : ""}`;

const isCount = (text: string): boolean => text !== "" && [...text].every((letter) => letter >= "0" && letter <= "9");

/** Whether a text is a number, or one with its unit. */
function isNumber(text: string): boolean {
  const [number = "", unit = ""] = text.split(" ");
  const digits = number.replace(/^[+-]+/, "").replace(".", "");
  return isCount(digits) && UNITS.includes(unit) && text.split(" ").length <= 2;
}

export const sayings = new Sayings();
