// Who began a run: people with the roles that they had then, the watch by itself, or the service.

import { language, type Key } from "./i18n.svelte";

export interface Begun {
  begun_by: string;
  begun_as: string[];
}

export function begunBy({ begun_by, begun_as }: Begun): string {
  const { t } = language;
  if (begun_by === "watch") return t("begun_alone");
  if (begun_by === "service") return t("the_service");
  const roles = begun_as.filter((role) => role !== "console").map((role) => t(`people_role_${role}` as Key));
  return roles.length > 0 ? `${begun_by} (${roles.join(", ")})` : begun_by;
}
