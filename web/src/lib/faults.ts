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

const ALL = "{procedure} cannot be run so: {faults}.";
const ONE = "{label} ({setting}): {fault}"; // what a setting is called and, for the terminal, its name
const BOUND = "Input should be {bound} {limit}";
const BOUNDS: Record<string, Key> = {
  "less than or equal to": "fault_most",
  "greater than or equal to": "fault_least",
  "less than": "fault_below",
  "greater than": "fault_above",
};

/** The settings that are wrong; empty where the service says something else. */
export function faultsOf(message: string): Fault[] {
  const found = messageOf(message);
  const faults = found?.template === ALL ? found.arguments.faults : undefined;
  if (faults === undefined || typeof faults === "string") return [];
  const each = faults.template === ONE ? [faults] : Object.values(faults.arguments);
  const all = each.map(faultOf);
  return all.includes(null) ? [] : (all as Fault[]);
}

function faultOf(one: Argument): Fault | null {
  if (typeof one === "string" || one.template !== ONE) return null;
  const { label = "", setting = "", fault = "" } = one.arguments;
  const called = english(label).split(" · ").map(sayings.say).join(" · ");
  return { setting: called, words: inWords(english(setting), fault) };
}

function inWords(path: string, fault: Argument): string {
  const { bound = "", limit = "" } = typeof fault !== "string" && fault.template === BOUND ? fault.arguments : {};
  const key = BOUNDS[english(bound)];
  if (key) return language.t(key, { limit: written(Number(english(limit)), unitOf(path)) });
  return english(fault) === "must be given" ? language.t("fault_needed") : sayings.say(english(fault));
}
