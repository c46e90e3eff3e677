// uPlot, fetched when the first plot is shown; with the marks that all plots share: shape says what colour says.

import type uPlot from "uplot";
import { colour } from "./theme.svelte";

export type { default as uPlot } from "uplot";

const NAMES = {
  used: "--plot-used", out: "--plot-out", odd: "--plot-odd", join: "--plot-join", limit: "--plot-limit", ink: "--plot-ink", grid: "--plot-grid",
} as const;

/** A colour of the marks and lines of plots, as the page shows it. */
export const plotColour = (what: keyof typeof NAMES): string => colour(NAMES[what]);

export async function plotter(): Promise<typeof uPlot> {
  const [{ default: made }] = await Promise.all([import("uplot"), import("uplot/dist/uPlot.min.css")]);
  return made;
}

export type Mark = "dot" | "cross" | "diamond" | "cross-diamond";

/** Draw one mark; ``size`` is its radius in canvas pixels. */
export function mark(pen: CanvasRenderingContext2D, kind: Mark, x: number, y: number, size: number) {
  pen.save();
  pen.lineWidth = Math.max(2, size * 0.4);
  if (kind === "dot") {
    pen.fillStyle = plotColour("used");
    pen.beginPath();
    pen.arc(x, y, size, 0, 2 * Math.PI);
    pen.fill();
  }
  if (kind === "cross" || kind === "cross-diamond") {
    pen.strokeStyle = plotColour("out");
    pen.beginPath();
    pen.moveTo(x - size, y - size);
    pen.lineTo(x + size, y + size);
    pen.moveTo(x + size, y - size);
    pen.lineTo(x - size, y + size);
    pen.stroke();
  }
  if (kind === "diamond" || kind === "cross-diamond") {
    const wide = size * 2;
    pen.strokeStyle = plotColour("odd");
    pen.fillStyle = plotColour("odd");
    pen.beginPath();
    pen.moveTo(x, y - wide);
    pen.lineTo(x + wide, y);
    pen.lineTo(x, y + wide);
    pen.lineTo(x - wide, y);
    pen.closePath();
    if (kind === "diamond") pen.fill();
    pen.stroke();
  }
  pen.restore();
}

/** How many decimals tell two neighbouring lines of an axis apart, and neither wrongly. */
export function decimalsOf(apart: number): number {
  let digits = 0;
  while (digits < 9 && Math.abs(apart * 10 ** digits - Math.round(apart * 10 ** digits)) > 1e-6) digits += 1;
  return digits;
}

const FONT = "15px system-ui, sans-serif"; // figures are read from two metres

/** An axis as all plots have it; ``written`` turns values into text, told how far apart they are. */
export function axis(label: string, written: (value: number, apart: number) => string, size = 64): uPlot.Axis {
  return {
    label,
    size,
    font: FONT,
    labelFont: FONT,
    stroke: plotColour("ink"),
    grid: { stroke: plotColour("grid"), width: 1 },
    ticks: { stroke: plotColour("grid"), width: 1 },
    values: (_, values, _axis, _space, apart) => values.map((value) => (value === null ? "" : written(value, apart))),
  };
}
