// The whole board to zoom into, with the outlines of its parts. Tiles come from the run's frames, on demand.
import { make } from "../parts/elements.js";
import { toPicture } from "../parts/board_picture.js";
import { texts } from "../texts/texts.js";

const SVG = "http://www.w3.org/2000/svg";
const LIBRARY = "/web/vendor/openseadragon/openseadragon.min.js";
const MARGIN = 2; // surroundings of a part that is flown to, in its own sizes

let loading = null;
function library() {
  loading ??= new Promise((done, failed) => {
    // Unless it finds an element of this name, the library adds a style for touch screens, which the page's policy refuses. An element
    // outside of HTML's namespace is no style.
    const instead = document.createElementNS("urn:vaoi", "style");
    instead.setAttribute("data-openseadragon-mobile-css", "");
    const script = make("script", { src: LIBRARY });
    script.onload = () => done(window.OpenSeadragon);
    script.onerror = () => {
      loading = null; // it is tried again for the next board
      failed(new TypeError(LIBRARY));
    };
    document.head.append(instead, script);
  });
  return loading;
}

export class DeepZoom {
  #root;
  #mosaics;
  #parts;
  #onChoose;
  #viewer = null;
  #shapes = new Map();
  #wanted = null;

  constructor(root, mosaics, parts, onChoose) {
    [this.#root, this.#mosaics, this.#parts, this.#onChoose] = [root, mosaics, parts, onChoose];
    const choice = make("select", {}, ...mosaics.map((m, n) => make("option", { value: n, textContent: m.name })));
    choice.setAttribute("aria-label", texts.mosaic);
    choice.addEventListener("change", () => this.#open(Number(choice.value)));
    const zoom = (sign, factor) => {
      const button = make("button", { type: "button", textContent: sign });
      button.addEventListener("click", () => (factor ? this.#viewer?.viewport.zoomBy(factor) : this.#viewer?.viewport.goHome()));
      return button;
    };
    this.#root.replaceChildren(make("div", { id: "zoom-tools" }, choice, zoom("+", 1.6), zoom("−", 1 / 1.6), zoom("□", 0)), make("div", { id: "zoom-view" }));
    this.#open(0);
  }

  async #open(n) {
    const mosaic = this.#mosaics[n];
    const OpenSeadragon = await library();
    if (!this.#root.isConnected) return;
    this.#viewer?.destroy();
    const viewer = OpenSeadragon({
      element: this.#root.querySelector("#zoom-view"), tileSources: mosaic.dzi, showNavigationControl: false, drawer: "canvas",
      maxZoomPixelRatio: 8, visibilityRatio: 0.5, gestureSettingsMouse: { clickToZoom: false }, imageSmoothingEnabled: true,
    });
    this.#viewer = viewer;
    const over = document.createElementNS(SVG, "svg");
    over.setAttribute("class", "parts");
    this.#shapes = new Map(this.#parts.map((part) => [part.address, this.#shape(part, mosaic)]));
    over.append(...this.#shapes.values());
    viewer.canvas.append(over);
    const place = () => {
      const image = viewer.world.getItemAt(0);
      if (!image) return;
      const from = image.imageToViewerElementCoordinates(new OpenSeadragon.Point(0, 0));
      const scale = image.imageToViewerElementCoordinates(new OpenSeadragon.Point(1, 0)).x - from.x;
      for (const shape of this.#shapes.values()) shape.setAttribute("transform", `translate(${from.x} ${from.y}) scale(${scale})`);
    };
    viewer.addHandler("update-viewport", place);
    viewer.addHandler("open", () => {
      place();
      if (this.#wanted) this.select(...this.#wanted);
    });
    viewer.addHandler("canvas-click", (event) => {
      const hit = document.elementsFromPoint(event.originalEvent.clientX, event.originalEvent.clientY).find((e) => e.dataset?.address);
      if (event.quick && hit) this.#onChoose(hit.dataset.address);
    });
    this.#root.dataset.mosaic = mosaic.name;
  }

  #corners(part, mosaic) {
    const angle = (part.rotation_deg * Math.PI) / 180;
    return [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([a, b]) => {
      const [x, y] = [(a * part.width_mm) / 2, (b * part.height_mm) / 2];
      return toPicture(mosaic.image_from_cad, [
        part.center_mm[0] + Math.cos(angle) * x - Math.sin(angle) * y,
        part.center_mm[1] + Math.sin(angle) * x + Math.cos(angle) * y,
      ]);
    });
  }

  #shape(part, mosaic) {
    const shape = document.createElementNS(SVG, "polygon");
    shape.setAttribute("points", this.#corners(part, mosaic).map((p) => p.map((v) => v.toFixed(2)).join(",")).join(" "));
    shape.setAttribute("class", part.unseen ? "unseen" : "");
    shape.dataset.address = part.address;
    shape.append(Object.assign(document.createElementNS(SVG, "title"), { textContent: part.address }));
    return shape;
  }

  // Mark a part; `fly`: move there.
  select(address, fly) {
    this.#wanted = [address, fly];
    for (const [name, shape] of this.#shapes) shape.classList.toggle("chosen", name === address);
    const image = this.#viewer?.world.getItemAt(0);
    const part = this.#parts.find((p) => p.address === address);
    if (!fly || !image || !part) return;
    const points = this.#corners(part, this.#mosaics.find((m) => m.name === this.#root.dataset.mosaic));
    const [xs, ys] = [points.map((p) => p[0]), points.map((p) => p[1])];
    const [x, y, w, h] = [Math.min(...xs), Math.min(...ys), Math.max(...xs) - Math.min(...xs), Math.max(...ys) - Math.min(...ys)];
    this.#viewer.viewport.fitBounds(image.imageToViewportRectangle(x - w * MARGIN, y - h * MARGIN, w * (1 + 2 * MARGIN), h * (1 + 2 * MARGIN)));
  }

  close() {
    this.#viewer?.destroy();
    this.#viewer = null;
  }
}
