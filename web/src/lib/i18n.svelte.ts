// Texts by key; every locale has every key (a test compares them). What procedures ask comes from the service.

import de from "../locales/de.json";
import en from "../locales/en.json";
import es from "../locales/es.json";
import zh from "../locales/zh.json";

const TEXTS = { en, de, es, zh } as const;
export type Locale = keyof typeof TEXTS;
export type Key = keyof typeof en;
export const LOCALES: { id: Locale; name: string }[] = [
  { id: "en", name: "English" },
  { id: "de", name: "Deutsch" },
  { id: "es", name: "Español" },
  { id: "zh", name: "中文" },
];

class Language {
  locale = $state<Locale>(remembered());

  choose(locale: Locale) {
    this.locale = locale;
    localStorage.setItem("locale", locale);
    speak(locale);
  }

  /** The text of a key, with {names} filled in. */
  t = (key: Key, values: Record<string, string | number> = {}): string => {
    const text: string = TEXTS[this.locale][key];
    return text.replace(/\{(\w+)\}/g, (whole, name) => String(values[name] ?? whole));
  };

  /** A number as this language writes it. */
  number = (value: number, digits: number): string =>
    value.toLocaleString(this.locale === "zh" ? "zh-Hans" : this.locale, {
      minimumFractionDigits: digits,
      maximumFractionDigits: digits,
      useGrouping: false,
    });
}

function remembered(): Locale {
  const asked = localStorage.getItem("locale") ?? navigator.language.slice(0, 2);
  const locale = (asked in TEXTS ? asked : "en") as Locale;
  speak(locale);
  return locale;
}

/** Tell the browser the language, and bring a device that has no Chinese characters ours. */
function speak(locale: Locale): void {
  document.documentElement.lang = locale === "zh" ? "zh-Hans" : locale;
  if (locale === "zh" && pictureOf("中") === pictureOf("\u{10FFFD}")) {
    void Promise.all([import("../../node_modules/.chinese-font/index.css"), import("@fontsource-variable/noto-sans-sc/index.css")]).then(
      () => document.documentElement.classList.add("brought-font"),
    );
  }
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
