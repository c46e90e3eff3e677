// Fields of a form whose text counts for nothing yet: not understood, asked about, or one of several that are missing.
// Without them the usual values would be used, while the screen shows what was typed: nothing begins before they are clear.

import { getContext, setContext } from "svelte";
import { SvelteMap } from "svelte/reactivity";

const KEY = Symbol("unread fields");

/** What the fields below this component are called that are not read yet. */
export const collectUnread = (): SvelteMap<object, string> => setContext(KEY, new SvelteMap<object, string>());

/** Name a field to the form that it is in, for as long as it is not read. */
export function nameUnread(label: () => string, isUnread: () => boolean): void {
  const fields = getContext<SvelteMap<object, string> | undefined>(KEY);
  const field = {};
  $effect(() => {
    if (!fields || !isUnread()) return;
    fields.set(field, label());
    return () => void fields.delete(field);
  });
}
