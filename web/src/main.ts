import { mount } from "svelte";
import App from "./App.svelte";
import "./app.css";
import { language } from "./lib/i18n.svelte";

history.scrollRestoration = "manual"; // each page begins at its head; a run shows its question

void language.ready.then(() => mount(App, { target: document.getElementById("app")! }));
