// Where an axis that begins at zero ends, and its lines: round figures, and little room above what is drawn.

const STEPS = [1, 2, 2.5, 5, 10]; // times a power of ten: apart by these, lines are read at a glance
const MOST_LINES = 6; // above zero: more are not read from two metres

export interface AxisLines {
  top: number;
  lines: number[]; // from zero to the top
  digits: number; // decimals that tell two neighbours apart
}

/** The lines of an axis that has room for the largest value. */
export function axisLines(largest: number): AxisLines {
  const rough = Math.max(largest, 1e-9) / MOST_LINES;
  const power = 10 ** Math.floor(Math.log10(rough) + 1e-9);
  const factor = STEPS.find((each) => each * power >= rough * (1 - 1e-9)) ?? 10;
  const count = Math.max(1, Math.ceil(largest / (factor * power) - 1e-9));
  const exponent = Math.round(Math.log10(power)) + (factor === 10 ? 1 : 0);
  const digits = Math.max(0, (factor === 2.5 ? 1 : 0) - exponent);
  return { top: count * factor * power, lines: Array.from({ length: count + 1 }, (_, i) => i * factor * power), digits };
}
