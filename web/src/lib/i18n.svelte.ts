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
    document.documentElement.lang = locale === "zh" ? "zh-Hans" : locale;
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
  document.documentElement.lang = locale === "zh" ? "zh-Hans" : locale;
  return locale;
}

export const language = new Language();
