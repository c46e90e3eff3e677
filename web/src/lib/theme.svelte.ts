// The colours of the pages: usual, for a dark hall, for a bright hall. Chosen per tablet and kept in its browser; a tablet
// on which nothing was chosen follows its system. The colours themselves stand in colours.css.

const STORAGE_KEY = "theme";
export const THEMES = ["usual", "dark", "bright"] as const;
export type ThemeName = (typeof THEMES)[number];

class Theme {
  chosen = $state<ThemeName | null>(null); // null: as the system has it
  #dark = matchMedia("(prefers-color-scheme: dark)");
  #contrast = matchMedia("(prefers-contrast: more)");
  #active = $state<ThemeName>("usual");

  constructor() {
    this.chosen = THEMES.find((name) => name === localStorage.getItem(STORAGE_KEY)) ?? null;
    for (const wish of [this.#dark, this.#contrast]) wish.addEventListener("change", () => this.#show());
    this.#show();
  }

  /** What is shown; what is drawn with script is drawn anew when this changes. */
  get shown(): ThemeName {
    return this.#active;
  }

  choose(name: ThemeName | null): void {
    this.chosen = name;
    if (name === null) localStorage.removeItem(STORAGE_KEY);
    else localStorage.setItem(STORAGE_KEY, name);
    this.#show();
  }

  #show(): void {
    this.#active = this.chosen ?? (this.#dark.matches ? "dark" : this.#contrast.matches ? "bright" : "usual");
    document.documentElement.dataset["theme"] = this.#active;
  }
}

export const theme = new Theme();

/** A colour of what is shown, by its name in colours.css, for what no style sheet reaches. */
export const colour = (name: `--${string}`): string =>
  getComputedStyle(document.documentElement).getPropertyValue(name).trim();
