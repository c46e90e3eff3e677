// The language of the page. What procedures ask comes from the service, and is said by say.svelte.ts.

import { later } from "./later";
import { LOCALES, textsOf, wantedLocale, type Key, type Locale, type Texts } from "./texts";

export { LOCALES, type Key, type Locale };

const AGAIN_MS = 1000;

class Language {
  locale = $state<Locale>(wantedLocale());
  /** When there is something to say. */
  readonly ready: Promise<void>;

  #texts = $state.raw({} as Texts);
  #turn = 0;

  constructor() {
    this.ready = this.#speak(this.locale);
  }

  /** Speak another language from when its texts are there; a link that is down leaves the page as it is. */
  async choose(locale: Locale): Promise<void> {
    localStorage.setItem("locale", locale);
    const turn = ++this.#turn;
    const texts = await textsOf(locale).catch(() => null);
    if (texts && turn === this.#turn) this.#say(locale, texts);
  }

  /** The text of a key, with {names} filled in. */
  t = (key: Key, values: Record<string, string | number> = {}): string => {
    const text: string = this.#texts[key];
    return text.replace(/\{(\w+)\}/g, (whole, name) => String(values[name] ?? whole));
  };

  /** The sign before decimals. */
  get decimal(): "," | "." {
    return this.locale === "de" || this.locale === "es" ? "," : ".";
  }

  /** A number as this language writes it. */
  number = (value: number, digits: number): string =>
    value.toLocaleString(this.locale === "zh" ? "zh-Hans" : this.locale, {
      minimumFractionDigits: digits,
      maximumFractionDigits: digits,
      useGrouping: false,
    });

  async #speak(locale: Locale): Promise<void> {
    for (;;) {
      const texts = await textsOf(locale).catch(() => null);
      if (texts) return this.#say(locale, texts);
      await new Promise((done) => setTimeout(done, AGAIN_MS));
    }
  }

  #say(locale: Locale, texts: Texts): void {
    this.#texts = texts;
    this.locale = locale;
    document.documentElement.lang = locale === "zh" ? "zh-Hans" : locale;
    if (locale === "zh" && pictureOf("中") === pictureOf("\u{10FFFD}")) void bringFont();
  }
}

/** Bring a device that has no Chinese characters ours, and then all others, which people may type. */
async function bringFont(): Promise<void> {
  await import("../../node_modules/.chinese-font/index.css");
  document.documentElement.classList.add("brought-font");
  later(() => import("@fontsource-variable/noto-sans-sc/index.css"));
}

/** How a character is drawn; one that no font has is drawn as a box. */
function pictureOf(character: string): string {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 32;
  const pen = canvas.getContext("2d");
  if (!pen) return character;
  pen.font = "24px system-ui, sans-serif";
  pen.fillText(character, 4, 26);
  return pen.getImageData(0, 0, 32, 32).data.join();
}

export const language = new Language();
