import { mount } from "svelte";
import Fleet from "./pages/Fleet.svelte";
import "./app.css";
import { language } from "./lib/i18n.svelte";
import "./lib/theme.svelte";

void language.ready.then(() => mount(Fleet, { target: document.getElementById("app")! }));
