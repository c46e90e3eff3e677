// What a device shows, and when that is too old: a live one by its values, any other by its state.

import { language } from "./i18n.svelte";
import type { Device } from "./types";
import { wire } from "./wire.svelte";

const VALUE_S = 2; // a live one tells ten values a second
const STATE_S = 5; // of others the state is asked once a second

/** Seconds since something, as they are now; null where it never was. */
export function grown(age_s: number | null): number | null {
  return age_s === null ? null : Math.max(0, age_s + (wire.nowMs - wire.liveAtMs) / 1000);
}

/** Whether nothing new is heard of it although something should be: not while a run waits for its reading. */
export function silent(device: Device): boolean {
  if (device.asked || device.typed || (!device.live && device.state === "unknown")) return false;
  const age = grown(device.age_s);
  if (device.role === "other_robot") return age === null; // looked at as often as the cell file says
  return age === null || age > (device.live ? VALUE_S : STATE_S);
}

/** How long ago, in the unit that a person would use. */
export function ago(age_s: number): string {
  const { t, number } = language;
  if (age_s < 90) return t("ago_s", { n: number(age_s, age_s < 10 ? 1 : 0) });
  return age_s < 5400 ? t("ago_min", { n: number(age_s / 60, 0) }) : t("ago_h", { n: number(age_s / 3600, 0) });
}

/** Its value in words; null where it has none. */
export function describeReading({ name, value }: Device): string | null {
  const { t, number } = language;
  if (!value) return null;
  if (value.length_m !== undefined) return `${number(value.length_m * 1000, 2)} mm`;
  if (value.joints_rad) {
    const axes = wire.session?.robots.find((each) => each.name === name)?.axis_names ?? [];
    const describeAxis = (angle: number, axis: number) => `${axes[axis] ?? `J${axis + 1}`} ${number((angle * 180) / Math.PI, 1)}°`;
    return value.joints_rad.map((angle, axis) => describeAxis(angle, axis).replace(" ", "\u00a0")).join("  "); // a name stays with its angle
  }
  if (value.position_m) {
    const [x, y, z] = value.position_m.map((along) => number(along * 1000, 3));
    return `x ${x}  y ${y}  z ${z} mm  (${t("station_n", { n: value.station ?? "–" })})`;
  }
  return value.closed === undefined ? null : t(value.closed ? "contact_closed" : "contact_open");
}
