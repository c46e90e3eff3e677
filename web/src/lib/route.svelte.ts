// Pages by the part of the address after "#": a link can be kept, and the back button works.

export type Page = "home" | "procedure" | "history" | "devices";

const PAGES: Page[] = ["procedure", "history", "devices"];

class Route {
  page = $state<Page>("home");
  detail = $state("");

  constructor() {
    this.#read();
    addEventListener("hashchange", () => this.#read());
  }

  #read() {
    const [page = "", detail = ""] = location.hash.replace(/^#\//, "").split("/").map(decodeURIComponent);
    this.page = PAGES.find((known) => known === page) ?? "home";
    this.detail = detail;
  }
}

export const route = new Route();
