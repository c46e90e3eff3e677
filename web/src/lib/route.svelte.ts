// Pages by the part of the address after "#": a link can be kept, and the back button works.

export type Page = "home" | "procedure" | "history" | "devices" | "parameters" | "programs" | "measurements" | "tablet" | "sign-in" | "enrol";

const PAGES: Page[] = ["procedure", "history", "devices", "parameters", "programs", "measurements", "tablet", "sign-in", "enrol"];

class Route {
  page = $state<Page>("home");
  detail = $state("");

  constructor() {
    this.#read();
    addEventListener("hashchange", () => this.#read());
  }

  #read() {
    const [page = "", detail = ""] = location.hash.replace(/^#\//, "").split("/").map(decoded);
    this.page = PAGES.find((each) => each === page) ?? "home";
    this.detail = detail;
  }
}

function decoded(part: string): string {
  try {
    return decodeURIComponent(part);
  } catch {
    return part; // a stray "%" in an address is no reason for an empty page
  }
}

export const route = new Route();
