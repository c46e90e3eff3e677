// The names under which built tables of texts hold them: half of a table would be its English templates, which a page
// knows from the service. A name is 40 bits of FNV-1a, from two starting values; the build fails where two are equal.
// Names cannot be packed, so each bit of them counts; alike texts side by side can.

const PRIME = 0x01000193;

function fnv1a(text: string, start: number): number {
  let hash = start;
  for (let at = 0; at < text.length; at++) hash = Math.imul(hash ^ text.charCodeAt(at), PRIME);
  return hash >>> 0;
}

/** Return the name of a template in a built table. */
export const tableKey = (template: string): string =>
  (fnv1a(template, 0x811c9dc5) * 0x100 + (fnv1a(template, 0x5bd1e995) >>> 24)).toString(36);

/** Return a table under the names of its templates. */
export function withTableKeys(table: Record<string, string>): Record<string, string> {
  const sorted = Object.entries(table).sort(([, one], [, other]) => (one < other ? -1 : 1));
  const named = Object.fromEntries(sorted.map(([template, text]) => [tableKey(template), text]));
  if (Object.keys(named).length < Object.keys(table).length) throw new Error("two templates have one name: use more bits");
  return named;
}
