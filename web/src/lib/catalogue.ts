// What procedures are called and what their settings are called, on every page. The titles are those of the catalogue.

import { fetchJson } from "./review";
import { sayings } from "./say.svelte";
import titles from "./procedure_titles.json";
import type { Procedure } from "./types";

const TITLES: Record<string, string> = titles;

/** What a procedure is called in the page's language; of one that this page does not know, its name with blanks. */
export const called = (procedure: string): string => sayings.say(TITLES[procedure] ?? procedure.replaceAll("_", " "));

/** The settings of a procedure as a JSON schema, which says what each is called; undefined of one that is no more. */
export async function schemaOf(procedure: string): Promise<Record<string, unknown> | undefined> {
  const all = await fetchJson<Procedure[]>("./api/procedures");
  return all.find((each) => each.name === procedure)?.settings;
}
