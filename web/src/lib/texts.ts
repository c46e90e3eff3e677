// The pages' own texts: one file a language, fetched when a page speaks it; each has every key (a test compares them).

import type en from "../locales/en.json";

export type Texts = typeof en;
export type Key = keyof Texts;

const FILES = import.meta.glob<Texts>("../locales/*.json", { import: "default" });

export const LOCALES = [
  { id: "en", name: "English" },
  { id: "de", name: "Deutsch" },
  { id: "es", name: "Español" },
  { id: "zh", name: "中文" },
] as const;
export type Locale = (typeof LOCALES)[number]["id"];

/** The language that was chosen on this device, else the browser's, else English. */
export function wantedLocale(): Locale {
  const requested = localStorage.getItem("locale") ?? navigator.language.slice(0, 2);
  return LOCALES.find(({ id }) => id === requested)?.id ?? "en";
}

export const textsOf = (locale: Locale): Promise<Texts> => FILES[`../locales/${locale}.json`]!();
