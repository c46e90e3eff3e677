// Days and times as people read them. The month is a word or stands between figures that name it: 11/12 is another day
// in every country. Hours are counted to 24, as on the certificate. What a server keeps is UTC, what is shown is the
// time of this device.

import { language } from "./i18n.svelte";

const DAY: Intl.DateTimeFormatOptions = { year: "numeric", month: "short", day: "numeric" };
const CLOCK: Intl.DateTimeFormatOptions = { hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23" };

const written = (moment: Date, how: Intl.DateTimeFormatOptions): string =>
  moment.toLocaleString(language.locale === "zh" ? "zh-Hans" : language.locale, how);

/** The day of a moment. */
export const day = (utc: string): string => written(new Date(utc), DAY);

/** A day of the calendar, as YYYY-MM-DD: the same one in every time zone. */
export const calendarDay = (date: string): string => written(new Date(`${date}T00:00:00`), DAY);

/** The time of a moment. */
export const clock = (utc: string): string => written(new Date(utc), CLOCK);

/** Day and time; where it stands beside a certificate in UTC, with the time zone. */
export const local = (utc: string, zoned = false): string =>
  written(new Date(utc), { ...DAY, ...CLOCK, ...(zoned ? { timeZoneName: "short" } : {}) });
