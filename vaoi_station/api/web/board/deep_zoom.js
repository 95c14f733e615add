// The whole board to zoom into, with its parts and what is drawn over them, beside another board if one is compared.
import { loadScript } from "../parts/elements.js";
import { boxOf, fullLevel, TILE_PX, tileAddress, toPicture } from "../parts/board_picture.js";
import { svg, titled } from "../parts/svg.js";
import { texts } from "../texts/texts.js";
import { classOf } from "./colours.js";
import { Drawings } from "./drawings.js";

const LIBRARY = new URL("../vendor/openseadragon/openseadragon.min.js", import.meta.url).href;
const MARGIN = 2; // surroundings of a part that is flown to, in its own sizes

// Unless it finds an element of this name, the library adds a style for touch screens, which the page's policy refuses. An element outside
// of HTML's namespace is no style.
const noStyle = document.createElementNS("urn:vaoi", "style");
noStyle.setAttribute("data-openseadragon-mobile-css", "");

async function library() {
  document.head.append(noStyle);
  await loadScript(LIBRARY);
  // Tiles that fail are said on the page; those that the browser gives up when the page is left are no fault.
  window.OpenSeadragon.console = { ...window.OpenSeadragon.console, error() {}, warn() {} };
  return window.OpenSeadragon;
}

// Load the library while the page waits for the parts of the board. A failure is reported when a mosaic is opened.
export const prepare = () => library().catch(() => {});

// What the viewer opens for a mosaic: tiles, or the one small picture that is kept. The list of mosaics says what their .dzi does.
const source = (mosaic) => (mosaic.dzi ? tiled(mosaic) : { type: "image", url: mosaic.url });
const tiled = (mosaic) => ({
  width: mosaic.width_px, height: mosaic.height_px, tileSize: TILE_PX, tileOverlap: 0, maxLevel: fullLevel(mosaic),
  getTileUrl: (level, column, row) => tileAddress(mosaic, level, column, row),
});

export class DeepZoom {
  #root;
  #parts = [];
  #onChoose;
  #onFailed;
  #library = null;
  #viewer = null;
  #mosaic = null;
  #over = null;
  #outlines = null;
  #shapes = new Map();
  #drawn = {};
  #wanted = null;
  #coloured = ["none", {}];
  #other = { mosaic: null, visible: true, from: 0 };
  #turn = 0;
  #placed = 0;
  complete = null; // resolves when every tile in view is there, or one could not be loaded

  // onChoose(address): a part was pressed; onFailed(): a piece of the picture could not be loaded.
  constructor(root, onChoose, onFailed) {
    [this.#root, this.#onChoose, this.#onFailed] = [root, onChoose, onFailed];
  }

  // Show a mosaic with the parts of its board, as far as they are known. If it is shown already, its tiles stay.
  async open(mosaic, parts) {
    const turn = ++this.#turn;
    this.#library = await library();
    if (!this.#root.isConnected || turn !== this.#turn) return;
    this.#parts = parts;
    if (this.#viewer && mosaic === this.#mosaic) {
      this.#outline();
      return;
    }
    const seen = this.#viewer?.viewport?.getBounds();
    this.#viewer?.destroy();
    this.#mosaic = mosaic;
    // immediateRender: the level that suits the screen is asked for first. With HDR the station has no overview of the board: a tile of the
    // levels before it costs much more, as it is made of the frames of the whole board.
    const viewer = this.#library({
      element: this.#root, tileSources: source(mosaic), showNavigationControl: false, drawer: "canvas",
      maxZoomPixelRatio: 8, visibilityRatio: 0.5, gestureSettingsMouse: { clickToZoom: false }, imageSmoothingEnabled: true, immediateRender: true,
    });
    this.#viewer = viewer;
    this.#over = svg("svg", { class: "parts" });
    const all = svg("g");
    this.#drawn = {};
    this.#outlines = svg("g", { class: "outlines" });
    all.append(this.#outlines);
    this.#over.append(all);
    viewer.canvas.append(this.#over);
    viewer.canvas.setAttribute("aria-label", texts.board.zoomHelp);
    const place = () => {
      const image = viewer.world.getItemAt(0);
      if (!image) return;
      const from = image.imageToViewerElementCoordinates(new this.#library.Point(0, 0));
      const scale = image.imageToViewerElementCoordinates(new this.#library.Point(1, 0)).x - from.x;
      all.setAttribute("transform", `translate(${from.x} ${from.y}) scale(${scale})`);
    };
    viewer.addHandler("update-viewport", place);
    viewer.addHandler("open", () => {
      if (seen) viewer.viewport.fitBounds(seen, true); // another light of the same place
      place();
      this.#root.dataset.mosaic = mosaic.name;
      if (this.#wanted) this.select(...this.#wanted);
      this.#placeOther();
    });
    this.complete = new Promise((done) => {
      viewer.world.addHandler("add-item", ({ item }) => item.addHandler("fully-loaded-change", ({ fullyLoaded }) => fullyLoaded && done()));
      viewer.addHandler("tile-load-failed", done);
    });
    viewer.addHandler("tile-load-failed", () => this.#onFailed());
    viewer.addHandler("canvas-key", (event) => {
      // The library's keys that rotate and mirror: what is drawn over the picture would not follow.
      if (/^[rf]$/i.test(event.originalEvent.key)) event.preventDefaultAction = true;
    });
    viewer.addHandler("canvas-click", (event) => {
      const hit = document.elementsFromPoint(event.originalEvent.clientX, event.originalEvent.clientY).find((e) => e.dataset?.address);
      if (event.quick && hit) this.#onChoose(hit.dataset.address);
    });
    this.#outline();
  }

  #outline() {
    this.#shapes = new Map(this.#parts.map((part) => [part.address, this.#shape(part)]));
    this.#outlines.replaceChildren(...this.#shapes.values());
    this.colour(...this.#coloured);
  }

  zoomBy(factor) {
    this.#viewer?.viewport?.zoomBy(factor);
  }

  home() {
    this.#viewer?.viewport?.goHome();
  }

  #shape(part) {
    const shape = svg("polygon", { points: part.footprint.map((point) => toPicture(this.#mosaic.image_from_cad, point)).map((p) => p.map((v) => v.toFixed(2)).join(",")).join(" ") });
    shape.dataset.address = part.address;
    return titled(shape, part.address);
  }

  // Colour the parts by a figure.
  colour(colour, measured) {
    this.#coloured = [colour, measured];
    for (const part of this.#parts) {
      const shape = this.#shapes.get(part.address);
      if (!shape) continue;
      const found = classOf(colour, part, measured);
      shape.setAttribute("class", [part.unseen && "unseen", found && `filled ${found.key}`, part.address === this.#wanted?.[0] && "chosen"].filter(Boolean).join(" "));
      shape.querySelector("title").textContent = found ? `${part.address}: ${found.text}` : part.address;
    }
  }

  // Show these drawings of an overlay; returns the factor by which residuals are enlarged.
  drawings(overlay, names) {
    if (!overlay || !this.#over) return null;
    const drawings = new Drawings(overlay, this.#mosaic);
    const all = this.#over.firstChild;
    for (const [name, group] of Object.entries(this.#drawn)) {
      if (!names.has(name)) {
        group.remove();
        delete this.#drawn[name];
      }
    }
    for (const name of names) {
      this.#drawn[name] ??= drawings.draw(name);
      // Frames lie below the parts, so that parts can still be pointed at.
      if (name === "frames") all.prepend(this.#drawn[name]);
      else all.append(this.#drawn[name]);
    }
    return drawings.factor;
  }

  // Mark a part; `fly`: move there.
  select(address, fly) {
    this.#wanted = [address, fly];
    for (const [name, shape] of this.#shapes) shape.classList.toggle("chosen", name === address);
    const part = this.#parts.find((p) => p.address === address);
    const chosen = this.#shapes.get(address);
    chosen?.parentNode.append(chosen); // in front of its neighbours
    if (fly && part) this.fly(part.footprint, MARGIN);
  }

  // Move to these points, CAD coordinates, with a margin in sizes of their box.
  fly(points, margin = 0) {
    const image = this.#viewer?.world?.getItemAt(0);
    if (!image) return;
    const [x0, y0, x1, y1] = boxOf(this.#mosaic, points, margin);
    this.#viewer.viewport.fitBounds(image.imageToViewportRectangle(x0, y0, x1 - x0, y1 - y0));
  }

  // Lay another board over this one: `mosaic` or null; shown or not, from this share of the width on.
  compare(mosaic, visible = true, from = 0) {
    const same = mosaic === this.#other.mosaic;
    this.#other = { mosaic, visible, from };
    if (same) this.#showOther();
    else this.#placeOther();
  }

  #placeOther() {
    const [viewer, turn] = [this.#viewer, ++this.#placed];
    if (!viewer?.world) return;
    for (let n = viewer.world.getItemCount() - 1; n > 0; n--) viewer.world.removeItem(viewer.world.getItemAt(n));
    if (!this.#other.mosaic) return;
    viewer.addTiledImage({
      tileSource: source(this.#other.mosaic), x: 0, y: 0, width: 1,
      success: ({ item }) => {
        // One that comes late, after another choice, would be taken for the chosen one.
        if (turn === this.#placed) this.#showOther();
        else viewer.world?.removeItem(item);
      },
    });
  }

  #showOther() {
    const item = this.#viewer?.world?.getItemAt(1);
    if (!item) return;
    const { visible, from } = this.#other;
    const { x: width, y: height } = item.getContentSize();
    item.setOpacity(visible ? 1 : 0);
    item.setClip(from > 0 ? new this.#library.Rect(width * from, 0, width * (1 - from), height) : null);
  }

  close() {
    this.#turn++;
    this.#viewer?.destroy();
    this.#viewer = null;
  }
}
