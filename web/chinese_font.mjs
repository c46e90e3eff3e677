// Cuts the characters of our own Chinese texts out of Noto Sans SC, for devices that have no Chinese font: about a sixth
// of what the font's pieces weigh. Only names and notes in other characters make such a device fetch whole pieces.
import { mkdir, readFile, rm, writeFile } from "node:fs/promises";
import { join } from "node:path";
import subsetFont from "subset-font";

const SOURCE = "node_modules/@fontsource-variable/noto-sans-sc";
const OUT = "node_modules/.chinese-font";
const PIECE = /url\(\.\/files\/(noto-sans-sc-\d+)-[^)]+\)[^}]*?unicode-range: ([^;]+);/g;
const FIRST_CHINESE = 0x2e80;
// What every page says, then what only refusals say: most pages need nothing of the second.
const TEXTS = {
  pages: ["src/locales/zh.json", "src/locales/procedures/zh.json"],
  refusals: ["src/locales/refusals/zh.json"],
};

const holds = (ranges, code) =>
  ranges.split(",").some((range) => {
    const [first, last = first] = range.trim().slice(2).split("-");
    return parseInt(first, 16) <= code && code <= parseInt(last, 16);
  });

await rm(OUT, { recursive: true, force: true });
await mkdir(OUT, { recursive: true });
const pieces = [...(await readFile(join(SOURCE, "index.css"), "utf8")).matchAll(PIECE)];
const left = new Set();
const faces = [];
const cut = new Set();
for (const [name, files] of Object.entries(TEXTS)) {
  const texts = await Promise.all(files.map((file) => readFile(file, "utf8")));
  const wanted = [...new Set(texts.join(""))].filter((one) => one.codePointAt(0) >= FIRST_CHINESE && !cut.has(one)).sort();
  for (const [, piece, ranges] of pieces) {
    const mine = wanted.filter((one) => !cut.has(one) && holds(ranges, one.codePointAt(0)));
    if (!mine.length) continue;
    const whole = await readFile(join(SOURCE, "files", `${piece}-wght-normal.woff2`));
    // One weight; a browser thickens it for headings.
    const small = await subsetFont(whole, mine.join(""), { targetFormat: "woff2", variationAxes: { wght: 400 } });
    const file = `${name}-${piece.replace("noto-sans-sc-", "")}.woff2`;
    await writeFile(join(OUT, file), small);
    const codes = mine.map((one) => `U+${one.codePointAt(0).toString(16)}`).join(",");
    faces.push(
      `@font-face{font-family:"Cellcal Noto Sans SC";font-display:swap;font-weight:400;` +
        `src:url(./${file}) format("woff2");unicode-range:${codes}}`,
    );
    mine.forEach((one) => cut.add(one));
  }
  wanted.filter((one) => !cut.has(one)).forEach((one) => left.add(one));
}
if (left.size) throw new Error(`no piece of ${SOURCE} holds ${[...left].join("")}`);
await writeFile(join(OUT, "index.css"), faces.join("\n"));
