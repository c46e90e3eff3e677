// What the service finds wrong with settings, setting by setting, in the units of the form and in the page's language.

import { language, type Key } from "./i18n.svelte";
import { sayings } from "./say.svelte";
import { unitOf } from "./units";
import { written } from "./values";

export interface Fault {
  setting: string;
  words: string;
}

const ALL = /^\S+ cannot be run so: (.*)\.$/s;
const ONE = /^(.*) \(([\w.]+)\): (.*)$/s; // what a setting is called and, for the terminal, its name
const BOUND = /^Input should be (less than or equal to|greater than or equal to|less than|greater than) (-?[\d.e+-]+)$/;
const BOUNDS: Record<string, Key> = {
  "less than or equal to": "fault_most",
  "greater than or equal to": "fault_least",
  "less than": "fault_below",
  "greater than": "fault_above",
};

/** The settings that are wrong; empty where the service says something else. */
export function faultsOf(message: string): Fault[] {
  const all = ALL.exec(message)?.[1]?.split("; ") ?? [];
  const found = all.map((each) => ONE.exec(each));
  if (found.includes(null)) return [];
  return found.map((each) => ({
    setting: each![1]!.split(" · ").map(sayings.say).join(" · "),
    words: inWords(each![2]!, each![3]!),
  }));
}

function inWords(path: string, words: string): string {
  if (words === "must be given") return language.t("fault_needed");
  const bound = BOUND.exec(words);
  if (!bound) return sayings.say(words);
  return language.t(BOUNDS[bound[1]!]!, { limit: written(Number(bound[2]), unitOf(path)) });
}
