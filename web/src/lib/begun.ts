// Who began a run: people with the roles that they had then, the watch by itself, or the service.

import { language, type Key } from "./i18n.svelte";
import { sayings } from "./say.svelte";

export interface Begun {
  begun_by: string;
  begun_as: string[];
}

export function begunBy({ begun_by, begun_as }: Begun): string {
  const { t } = language;
  if (begun_by === "watch") return t("begun_alone");
  if (begun_by === "service") return t("the_service");
  const who = sayings.say(begun_by); // whoever sits at the cell's own computer has no name
  const roles = begun_as.filter((role) => role !== "console").map((role) => t(`people_role_${role}` as Key));
  return roles.length > 0 ? t("begun_as", { who, roles: sayings.listed(...roles) }) : who;
}
