// What the service finds wrong with settings, setting by setting, in the units of the form and in the page's language.

import { language, type Key } from "./i18n.svelte";
import { english, messageOf, type Argument } from "./messages";
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

function faultOf(one: Argument): Fault | null {
  if (typeof one === "string" || one.template !== ONE) return null;
  const { setting = "", fault = "" } = one.arguments;
  return { setting: nameOf(english(setting)), words: inWords(english(setting), fault) };
}

function inWords(path: string, fault: Argument): string {
  const { bound = "", limit = "" } = typeof fault !== "string" && fault.template === BOUND ? fault.arguments : {};
  const key = BOUNDS[english(bound)];
  if (key) return language.t(key, { limit: written(Number(english(limit)), unitOf(path)) });
  return english(fault) === "must be given" ? language.t("fault_needed") : sayings.say(english(fault));
}
