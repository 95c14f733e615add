// What is shown of a board, kept in the address: a link reproduces the part, the overlay, the pictures and the comparison.
import { stateShown } from "../parts/settings.js";

const DEFAULTS = {
  component: "", // address of the chosen part
  tab: "part", // part, report, timing, export
  colour: "none", // what parts are coloured by: none, sigma, views, height, presence, shift, turn, orientation, alike
  show: "", // frames, links, fiducials, residuals: separated by commas
  mosaic: "", // name of the mosaic; empty: the first
  light: "", // pictures under this light only
  minus: "", // its difference with this light
  hdr: "", // "1": merged of all exposures
  picture: "", // camera.row of the large picture
  size: "fit", // fit, or 1:1
  with: "", // what the board is compared with: previous, reference, or the id of a run
  how: "slider", // slider, blink, or beside
};

export class PageState {
  #id;
  #values;

  constructor(id, query) {
    this.#id = id;
    const given = new URLSearchParams(query);
    this.#values = Object.fromEntries(Object.entries(DEFAULTS).map(([name, value]) => [name, given.get(name) ?? value]));
  }

  get(name) {
    return this.#values[name];
  }

  // Which of the drawings that can be shown together are shown.
  shown() {
    return new Set(this.get("show").split(",").filter(Boolean));
  }

  set(changes) {
    // An address that says the same in other characters stays: the frame of the page would take it for another one.
    if (Object.entries(changes).every(([name, value]) => this.#values[name] === value)) return;
    Object.assign(this.#values, changes);
    stateShown(`#/board/${encodeURIComponent(this.#id)}`, this.#query());
  }

  #query() {
    return new URLSearchParams(Object.entries(this.#values).filter(([name, value]) => value !== DEFAULTS[name]));
  }

  // The address of another board, shown as this one is.
  of(id) {
    const query = String(this.#query());
    return `#/board/${encodeURIComponent(id)}${query ? `?${query}` : ""}`;
  }
}
