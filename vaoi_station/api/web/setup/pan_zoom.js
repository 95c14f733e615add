// An SVG that is moved and zoomed by wheel, drag, buttons and keys: + − 0, and arrows unless the page uses them.
import { signButton } from "../parts/elements.js";
import { texts } from "../texts/texts.js";

const MOST = 400; // times
const STEP = 1.5;

export class PanZoom {
  #svg;
  #whole;
  #box;
  #onChange;

  // `whole`: [x, y, width, height] in the drawing's units; `onKey(event)` returns true if it has used the key.
  constructor(svg, whole, { onKey = () => false, onChange = () => {} } = {}) {
    [this.#svg, this.#whole, this.#box, this.#onChange] = [svg, whole, [...whole], onChange];
    svg.setAttribute("tabindex", "0");
    svg.setAttribute("preserveAspectRatio", "xMidYMid meet");
    svg.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(event.deltaY < 0 ? 1.2 : 1 / 1.2, this.at(event));
    }, { passive: false });
    svg.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      let last = this.at(event);
      const move = (e) => {
        const now = this.at(e);
        this.#to([this.#box[0] + last[0] - now[0], this.#box[1] + last[1] - now[1], this.#box[2], this.#box[3]]);
        last = this.at(e);
      };
      const end = () => {
        svg.removeEventListener("pointermove", move);
        for (const name of ["pointerup", "pointerleave", "pointercancel"]) svg.removeEventListener(name, end);
      };
      svg.addEventListener("pointermove", move);
      for (const name of ["pointerup", "pointerleave", "pointercancel"]) svg.addEventListener(name, end);
    });
    svg.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.altKey || event.metaKey) return;
      if (onKey(event) || this.#key(event)) event.preventDefault();
    });
    this.home();
  }

  get tools() {
    return [
      signButton("+", texts.setup.zoomIn, () => this.zoom(STEP)), signButton("−", texts.setup.zoomOut, () => this.zoom(1 / STEP)),
      signButton("□", texts.setup.zoomAll, () => this.home()),
    ];
  }

  get box() {
    return this.#box;
  }

  // The place under the pointer, in the drawing's units.
  at(event) {
    const place = new DOMPoint(event.clientX, event.clientY).matrixTransform(this.#svg.getScreenCTM().inverse());
    return [place.x, place.y];
  }

  home() {
    this.#to([...this.#whole]);
  }

  zoom(factor, at = [this.#box[0] + this.#box[2] / 2, this.#box[1] + this.#box[3] / 2]) {
    const width = Math.min(Math.max(this.#box[2] / factor, this.#whole[2] / MOST), this.#whole[2] * 2);
    const share = width / this.#box[2];
    this.#to([at[0] - (at[0] - this.#box[0]) * share, at[1] - (at[1] - this.#box[1]) * share, width, this.#box[3] * share]);
  }

  #key(event) {
    const [x, y, width, height] = this.#box;
    const moves = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[event.key];
    if (moves) this.#to([x + moves[0] * width, y + moves[1] * height, width, height]);
    else if (event.key === "+") this.zoom(STEP);
    else if (event.key === "-") this.zoom(1 / STEP);
    else if (event.key === "0") this.home();
    else return false;
    return true;
  }

  #to(box) {
    this.#box = box;
    this.#svg.setAttribute("viewBox", box.join(" "));
    this.#onChange(this);
  }
}
