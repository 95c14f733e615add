// The left side of a board's page: the whole board, the search for parts, what is drawn over it, and the legend.
import { make, options, setText, View } from "../parts/elements.js";
import { unattended } from "../parts/rest.js";
import { number, texts } from "../texts/texts.js";
import { classes, COLOURS, worstFirst } from "./colours.js";
import { DeepZoom, prepare } from "./deep_zoom.js";
import { DRAWINGS } from "./drawings.js";

const PART = `
<div id="zoom-tools">
  <form id="finder" role="search">
    <button type="button" id="before" data-label="board.before">‹</button>
    <input id="component" list="component-names" autocomplete="off" spellcheck="false" data-label="component">
    <datalist id="component-names"></datalist>
    <button type="button" id="after" data-label="board.after">›</button>
  </form>
  <label><span data-text="board.colourBy"></span><select id="colour"></select></label>
  <select id="mosaic" data-label="mosaic"></select>
  <div id="drawings" role="group" data-label="board.drawings"></div>
  <div id="zoom-buttons"><button type="button" id="closer" data-label="board.closer">+</button><button type="button" id="farther" data-label="board.farther">−</button><button type="button" id="whole" data-label="board.wholeBoard">□</button></div>
</div>
<p id="finder-answer" role="alert"></p>
<div id="zoom-view"></div>
<p id="zoom-note"></p>
<ul id="legend" aria-live="polite"></ul>`;

export class ZoomSide extends View {
  #state;
  #onPart;
  #deep = null;
  #parts = [];
  #mosaics = [];
  #overlay = null;
  #measured = {};

  // state: PageState; onPart(address): a part was chosen.
  constructor(root, state, onPart) {
    super(PART, root);
    [this.#state, this.#onPart] = [state, onPart];
    prepare();
    this.part("colour").append(...options(COLOURS.map((value) => [value, texts.board.colours[value]])));
    this.part("colour").value = state.get("colour");
    this.part("colour").addEventListener("change", () => this.#recolour(this.part("colour").value));
    this.part("drawings").append(...DRAWINGS.map((name) => this.#toggle(name)));
    this.part("finder").addEventListener("submit", (event) => {
      event.preventDefault();
      this.#find();
    });
    this.part("component").addEventListener("change", () => this.#find());
    this.part("component").addEventListener("focus", () => this.part("component").select());
    this.part("before").addEventListener("click", () => this.#step(-1));
    this.part("after").addEventListener("click", () => this.#step(1));
    this.part("closer").addEventListener("click", () => this.#deep?.zoomBy(1.6));
    this.part("farther").addEventListener("click", () => this.#deep?.zoomBy(1 / 1.6));
    this.part("whole").addEventListener("click", () => this.#deep?.home());
    this.part("mosaic").addEventListener("change", () => {
      state.set({ mosaic: this.part("mosaic").value });
      unattended(this.#open());
    });
  }

  #toggle(name) {
    const button = make("button", { type: "button", textContent: texts.board[name] });
    button.setAttribute("aria-pressed", this.#state.shown().has(name));
    button.dataset.drawing = name;
    button.addEventListener("click", () => {
      const shown = this.#state.shown();
      if (!shown.delete(name)) shown.add(name);
      this.#state.set({ show: [...shown].join(",") });
      button.setAttribute("aria-pressed", shown.has(name));
      this.#redraw();
    });
    return button;
  }

  // Open the picture of a run, and wait until it is complete. The list of its parts takes as long: `show` follows with it.
  async begin(mosaics) {
    this.#mosaics = mosaics;
    this.root.classList.remove("empty");
    await this.#open();
    await this.#deep?.complete;
  }

  // Show a run: its parts, mosaics (none: `why` says so, a text or elements), and overlay, or null.
  async show({ parts, mosaics, overlay, why }) {
    [this.#parts, this.#mosaics, this.#overlay] = [parts, mosaics, overlay];
    this.part("component-names").replaceChildren(...parts.map((part) => make("option", { value: part.address })));
    this.part("mosaic").replaceChildren(...options(mosaics.map((m) => [m.name, m.kept ? texts.board.kept : m.name])));
    this.part("mosaic").hidden = mosaics.length < 2;
    this.part("finder").hidden = parts.length === 0;
    for (const button of this.part("drawings").children) button.disabled = !overlay || mosaics.length === 0;
    this.part("colour").disabled = mosaics.length === 0;
    this.part("zoom-note").replaceChildren(...[why].flat());
    this.root.classList.toggle("empty", mosaics.length === 0);
    if (mosaics.length) await this.#open();
    else {
      this.close();
      this.#legend();
    }
  }

  async #open() {
    const mosaic = this.#mosaics.find((m) => m.name === this.#state.get("mosaic")) ?? this.#mosaics[0];
    this.part("mosaic").value = mosaic.name;
    this.#deep ??= new DeepZoom(
      this.part("zoom-view"), (address) => this.#onPart(address), () => setText(this.part("zoom-note"), texts.board.tilesFailed),
    );
    await this.#deep.open(mosaic, this.#parts);
    this.#recolour(this.#state.get("colour"));
    this.#redraw();
  }

  // measured: heights and measures of parts, as `classOf` takes them.
  measured(measured) {
    this.#measured = measured;
    this.#recolour(this.#state.get("colour"));
  }

  #recolour(colour) {
    this.#state.set({ colour });
    this.part("colour").value = colour;
    this.#deep?.colour(colour, this.#measured);
    this.#legend();
  }

  #redraw() {
    const shown = new Set(DRAWINGS.filter((name) => this.#state.shown().has(name)));
    this.factor = this.#deep?.drawings(this.#overlay, shown) ?? null;
    this.#legend();
  }

  // What colours and lines mean, with their units.
  #legend() {
    const shown = this.#state.shown();
    const entry = (className, text) => make("li", {}, make("span", { className: `key ${className}` }), text);
    const entries = classes(this.#state.get("colour")).map(([key, label]) => entry(`filled ${key}`, label));
    if (entries.length) entries.unshift(make("li", { className: "title", textContent: texts.board.legend[this.#state.get("colour")] }));
    if (this.#parts.some((part) => part.unseen)) entries.push(entry("unseen", texts.facts.unseen));
    for (const name of DRAWINGS) if (shown.has(name) && this.#overlay) entries.push(entry(`line-${name}`, name === "residuals" && this.factor ? texts.board.enlarged(number(this.factor)) : texts.board[name]));
    this.part("legend").replaceChildren(...(this.#mosaics.length ? entries : []));
  }

  #find() {
    const wanted = this.part("component").value.trim();
    const found = this.#parts.find((part) => part.address.toLowerCase() === wanted.toLowerCase()) ?? this.#parts.find((part) => part.ref.toLowerCase() === wanted.toLowerCase());
    setText(this.part("finder-answer"), found || !wanted ? "" : texts.board.noPart(wanted));
    if (found) this.#onPart(found.address);
  }

  // The next part: the worst by the present colour first.
  #step(by) {
    const order = worstFirst(this.#state.get("colour"), this.#parts, this.#measured);
    const at = order.findIndex((part) => part.address === this.#state.get("component"));
    if (order.length) this.#onPart(order[(at + by + order.length) % order.length].address);
  }

  choose(address, fly) {
    this.part("component").value = address;
    setText(this.part("finder-answer"), "");
    this.#deep?.select(address, fly);
  }

  // Lead to these points of the board, CAD coordinates, with a drawing and a colouring that show why.
  lead(drawing, colour, points) {
    const button = this.root.querySelector(`[data-drawing="${drawing}"][aria-pressed="false"]`);
    button?.click();
    if (colour) this.#recolour(colour);
    this.#deep?.fly(points);
  }

  compare(mosaic, visible, from) {
    this.#deep?.compare(mosaic, visible, from);
  }

  close() {
    this.#deep?.close();
    this.#deep = null;
  }
}
