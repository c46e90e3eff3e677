import { mount } from "svelte";
import Fleet from "./pages/Fleet.svelte";
import "./app.css";

mount(Fleet, { target: document.getElementById("app")! });
