// What is drawn over the whole board: frames, links, fiducials and residuals, in pixels of the mosaic.
import { toPicture } from "../parts/board_picture.js";
import { svg, titled } from "../parts/svg.js";
import { number, texts } from "../texts/texts.js";

const LONG_SHARE = 0.05; // length of a large residual's arrow, in widths of the board

export const DRAWINGS = ["frames", "links", "fiducials", "residuals"];
const named = ([camera, row]) => `${camera}/${row}`;
const points = (corners) => corners.map((p) => p.map((v) => v.toFixed(2)).join(",")).join(" ");

export class Drawings {
  #overlay;
  #at;

  // overlay: of the run; mosaic: entry with image_from_cad.
  constructor(overlay, mosaic) {
    [this.#overlay, this.#at] = [overlay, (point) => toPicture(mosaic.image_from_cad, point)];
    const lengths = this.#residuals().map((r) => r.residual_px).sort((a, b) => a - b);
    const large = lengths[Math.floor(lengths.length * 0.9)] ?? 0;
    const wide = (mosaic.width_px * overlay.px_per_mm) / (mosaic.px_per_mm ?? overlay.px_per_mm);
    // A factor of one digit, so that it can be read.
    const wanted = large > 0 ? (LONG_SHARE * wide) / large : 1;
    const digit = 10 ** Math.floor(Math.log10(wanted));
    this.factor = Math.max(1, Math.floor(wanted / digit) * digit);
  }

  #residuals() {
    return [...this.#overlay.links, ...this.#overlay.fiducials].filter((entry) => entry.residual_px != null);
  }

  draw(name) {
    const group = svg("g", { class: `drawn-${name}` });
    group.append(...this[`_${name}`]());
    return group;
  }

  _frames() {
    return this.#overlay.frames.map((f) => {
      const sigma = f.sigma_px == null ? "" : `, σ ${number(f.sigma_px, 3)} px`;
      const shape = svg("polygon", { points: points(f.corners.map(this.#at)), class: f.usable ? "" : "lost" });
      return titled(shape, texts.board.frame(f.camera, f.row, f.light ?? "") + sigma);
    });
  }

  _links() {
    const centres = new Map(this.#overlay.frames.map((f) => [named([f.camera, f.row]), middle(f.corners.map(this.#at))]));
    return this.#overlay.links.flatMap((pair) => {
      const [a, b] = [centres.get(named(pair.a)), centres.get(named(pair.b))];
      if (!a || !b) return [];
      const line = svg("line", { x1: a[0], y1: a[1], x2: b[0], y2: b[1], class: pair.used ? (pair.used > 30 ? "many" : "") : "lost" });
      const rms = pair.rms_px == null ? "" : `, ${number(pair.rms_px, 3)} px`;
      return [titled(line, `${texts.board.pair(named(pair.a), named(pair.b))}: ${pair.used ? texts.board.linksOf(pair.used, pair.found) : pair.why}${rms}`)];
    });
  }

  _fiducials() {
    return this.#overlay.fiducials.map((mark) => {
      const [[x, y], [edge]] = [this.#at(mark.at), this.#at([mark.at[0] + mark.diameter / 2, mark.at[1]])];
      const shape = svg("g", { class: mark.sightings ? "" : "lost" });
      const r = Math.abs(edge - x);
      shape.append(svg("circle", { cx: x, cy: y, r }), svg("path", { d: `M${x - 2 * r} ${y}h${4 * r}M${x} ${y - 2 * r}v${4 * r}` }));
      const off = mark.residual_px == null ? "" : `, ${number(mark.residual_px, 3)} px`;
      return titled(shape, `${mark.name}: ${texts.board.sightings(mark.sightings)}${off}`);
    });
  }

  _residuals() {
    return this.#residuals().flatMap((entry) => {
      if (!entry.at) return [];
      const [from, to] = [entry.at, [entry.at[0] + entry.residual[0] * this.factor, entry.at[1] + entry.residual[1] * this.factor]].map(this.#at);
      const arrow = svg("g", { class: entry.name ? "of-fiducial" : "" });
      arrow.append(
        svg("path", { class: "start", d: `M${from[0]} ${from[1]}h0` }),
        svg("line", { x1: from[0], y1: from[1], x2: to[0], y2: to[1] }),
      );
      const who = entry.name ?? texts.board.pair(named(entry.a), named(entry.b));
      return [titled(arrow, `${who}: ${number(entry.residual_px, 3)} px`)];
    });
  }
}

function middle(corners) {
  return [0, 1].map((n) => corners.reduce((sum, corner) => sum + corner[n], 0) / corners.length);
}
