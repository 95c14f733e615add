// A small picture of the whole board from its mosaic, with the parts that were not seen hatched.
import * as rest from "./rest.js";
import { make } from "./elements.js";
import { svg, titled } from "./svg.js";

const TILE = 256;
export function toPicture(matrix, [x, y]) {
  const [u, v, w] = matrix.map((row) => row[0] * x + row[1] * y + row[2]);
  return [u / w, v / w];
}

// Resolves to an element, or to null if there is no mosaic. `steps`: how often the smallest level is doubled.
export async function boardPicture(run, { steps = 1, alt = "" } = {}) {
  if (run.verdict === "failed" || run.verdict == null || (!run.frames_available && !run.recording)) return null;
  const [mosaic] = await rest.mosaics(run.id);
  if (!mosaic) return null;
  const largest = Math.ceil(Math.log2(Math.max(mosaic.width_px, mosaic.height_px)));
  const reduction = Math.max(mosaic.levels - 1 - steps, 0);
  const [width, height] = [mosaic.width_px, mosaic.height_px].map((side) => Math.ceil(side / 2 ** reduction));
  const box = make("div", { className: "board-picture" });
  box.setAttribute("role", "img");
  box.setAttribute("aria-label", alt);
  box.style.aspectRatio = `${width} / ${height}`;
  box.style.setProperty("--ratio", width / height); // the style sheet fits it into its place
  const tiles = mosaic.dzi.replace(/\.dzi$/, "_files");
  const waits = [];
  for (let row = 0; row * TILE < height; row++) {
    for (let column = 0; column * TILE < width; column++) {
      const tile = make("img", { alt: "", src: `${tiles}/${largest - reduction}/${column}_${row}.jpg?_=${encodeURIComponent(run.started)}` });
      Object.assign(tile.style, {
        left: `${(column * TILE * 100) / width}%`, top: `${(row * TILE * 100) / height}%`,
        width: `${(Math.min(TILE, width - column * TILE) * 100) / width}%`,
      });
      waits.push(tile.decode().catch(() => tile.remove()));
      box.append(tile);
    }
  }
  if (run.unseen?.length) box.append(await hatched(run, mosaic));
  await Promise.all(waits);
  return box;
}

async function hatched(run, mosaic) {
  const parts = await rest.components(run.id, { unseen: true });
  const over = svg("svg", { viewBox: `0 0 ${mosaic.width_px} ${mosaic.height_px}`, class: "unseen-parts" });
  const step = Math.max(mosaic.width_px, mosaic.height_px) / 60;
  over.append(svg("pattern", { id: "hatch", width: step, height: step, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" },
    svg("rect", { width: step, height: step, class: "hatch-ground" }), svg("rect", { width: step / 2, height: step, class: "hatch-line" })));
  for (const part of parts) {
    const points = part.footprint.map((corner) => toPicture(mosaic.image_from_cad, corner).map((v) => v.toFixed(1)).join(",")).join(" ");
    over.append(titled(svg("polygon", { points, fill: "url(#hatch)", "stroke-width": step / 4 }), part.address));
  }
  return over;
}
