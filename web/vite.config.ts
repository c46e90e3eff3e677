import { cp, readdir, readFile, writeFile } from "node:fs/promises";
import { join } from "node:path";
import { promisify } from "node:util";
import { brotliCompress, gzip } from "node:zlib";
import { svelte } from "@sveltejs/vite-plugin-svelte";
import { defineConfig, type Plugin } from "vite";
import { withTableKeys } from "./src/lib/table_keys";

const DIST = "../service/web/dist";
const SMALL = 1000; // bytes; less is not worth packing

// Packed once, here: the service would keep everybody waiting while it packs half a megabyte.
const packed: Plugin = {
  name: "packed",
  apply: "build",
  async closeBundle() {
    for (const found of await readdir(DIST, { recursive: true })) {
      if (!/\.(js|css|html|svg)$/.test(found)) continue;
      const file = join(DIST, found);
      const text = await readFile(file);
      if (text.length < SMALL) continue;
      await writeFile(`${file}.gz`, await promisify(gzip)(text, { level: 9 }));
      await writeFile(`${file}.br`, await promisify(brotliCompress)(text));
    }
  },
};

// The service prints reports in the reader's language from the same tables as the pages.
const tables: Plugin = {
  name: "tables",
  apply: "build",
  async closeBundle() {
    for (const kind of ["procedures", "settings", "refusals"]) await cp(`src/locales/${kind}`, join(DIST, "locales", kind), { recursive: true });
  },
};

// Pages look texts up by short names in place of the English templates, which would be half of each table.
const named: Plugin = {
  name: "named",
  enforce: "pre",
  async load(id) {
    if (!/\/locales\/(procedures|settings|refusals)\/\w+\.json$/.test(id)) return null;
    return JSON.stringify(withTableKeys(JSON.parse(await readFile(id, "utf8")) as Record<string, string>));
  },
};

// What comes into the cell is asked while the page is still loading: a script of its own, beside the page's.
const early: Plugin = {
  name: "early",
  transformIndexHtml: {
    order: "post",
    handler(_, { bundle, path }) {
      const script = Object.values(bundle ?? {}).find((file) => file.type === "chunk" && file.name === "early");
      if (!script || path !== "/index.html") return [];
      return [{ tag: "script", attrs: { type: "module", async: true, src: `./${script.fileName}` }, injectTo: "head-prepend" }];
    },
  },
};

// The pages are built into the Python package: a user needs no Node.
export default defineConfig({
  plugins: [svelte(), early, named, packed, tables],
  base: "./",
  build: {
    outDir: DIST,
    emptyOutDir: true,
    target: "es2022",
    rollupOptions: { input: ["index.html", "fleet.html", "src/lib/early.ts"] },
    assetsInlineLimit: 0, // the content security policy allows no data: scripts or styles
  },
  server: { proxy: { "/api": { target: "http://127.0.0.1:8470", ws: true } } },
});
