import { svelte } from "@sveltejs/vite-plugin-svelte";
import { defineConfig } from "vite";

// The pages are built into the Python package: a user needs no Node.
export default defineConfig({
  plugins: [svelte()],
  base: "./",
  build: {
    outDir: "../service/web/dist",
    emptyOutDir: true,
    target: "es2022",
    rollupOptions: { input: ["index.html", "fleet.html"] },
    assetsInlineLimit: 0, // the content security policy allows no data: scripts or styles
  },
  server: { proxy: { "/api": { target: "http://127.0.0.1:8470", ws: true } } },
});
