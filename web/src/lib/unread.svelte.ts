// Fields of a form whose text counts for nothing yet: not understood, asked about, or one of several that are missing;
// and those that must be filled in and are empty. Nothing begins before they are clear: the usual values would be used
// while the screen shows what was typed, or the service would refuse.

import { getContext, setContext } from "svelte";
import { SvelteMap } from "svelte/reactivity";

type Names = SvelteMap<object, string>;
interface OpenFields {
  unread: Names;
  needed: Names;
}

const KEY = Symbol("open fields");

/** What the fields below this component are called that are not read yet, or needed and empty. */
export const collectFields = (): OpenFields =>
  setContext(KEY, { unread: new SvelteMap<object, string>(), needed: new SvelteMap<object, string>() });

/** Name a field to the form that it is in, for as long as it is not read. */
export const nameUnread = (label: () => string, isUnread: () => boolean): void => name("unread", label, isUnread);

/** Name a field to the form that it is in, for as long as it must be filled in and is empty. */
export const nameNeeded = (label: () => string, isEmpty: () => boolean): void => name("needed", label, isEmpty);

function name(kind: keyof OpenFields, label: () => string, isOpen: () => boolean): void {
  const fields = getContext<OpenFields | undefined>(KEY)?.[kind];
  const field = {};
  $effect(() => {
    if (!fields || !isOpen()) return;
    fields.set(field, label());
    return () => void fields.delete(field);
  });
}
