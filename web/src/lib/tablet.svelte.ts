// What is chosen per tablet and kept in its browser: the size of the words and whether the tour was left.

const SIZE = "text-size";
const TOUR = "tour-left";

class Tablet {
  large = $state(localStorage.getItem(SIZE) === "large");
  tour = $state(localStorage.getItem(TOUR) === null);

  constructor() {
    this.#show();
  }

  chooseSize(large: boolean): void {
    this.large = large;
    localStorage.setItem(SIZE, large ? "large" : "usual");
    this.#show();
  }

  chooseTour(on: boolean): void {
    this.tour = on;
    if (on) localStorage.removeItem(TOUR);
    else localStorage.setItem(TOUR, "yes");
  }

  #show(): void {
    document.documentElement.classList.toggle("large-text", this.large);
  }
}

export const tablet = new Tablet();
