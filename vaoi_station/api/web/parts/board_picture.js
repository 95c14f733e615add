// A small picture of the whole board from its mosaic, with the parts that were not seen hatched.
import * as rest from "./rest.js";
import { make } from "./elements.js";
import { svg, titled } from "./svg.js";

// Tiles of a mosaic: its levels halve, from the level of full resolution down.
export const TILE_PX = 256;
export const fullLevel = ({ width_px, height_px }) => Math.ceil(Math.log2(Math.max(width_px, height_px)));
export const tileAddress = ({ dzi }, level, column, row) => `${dzi.replace(/\.dzi$/, "_files")}/${level}/${column}_${row}.jpg`;
// After a reinstallation run ids may repeat; the start time keeps the browser from using a cached picture.
export const tileOfRun = (run, mosaic, level, column, row) => `${tileAddress(mosaic, level, column, row)}?_=${encodeURIComponent(run.started)}`;

export function toPicture(matrix, [x, y]) {
  const [u, v, w] = matrix.map((row) => row[0] * x + row[1] * y + row[2]);
  return [u / w, v / w];
}

// Resolves to an element, or to null if there is no mosaic. `steps`: how often the smallest level is doubled.
export async function boardPicture(run, { steps = 1, alt = "" } = {}) {
  if (run.verdict === "failed" || run.verdict == null || (!run.frames_available && !run.recording)) return null;
  const [mosaic] = await rest.mosaics(run.id);
  if (!mosaic) return null;
  const reduction = Math.max(mosaic.levels - 1 - steps, 0);
  const [width, height] = [mosaic.width_px, mosaic.height_px].map((side) => Math.ceil(side / 2 ** reduction));
  const box = make("div", { className: "board-picture", role: "img", ariaLabel: alt });
  box.style.aspectRatio = `${width} / ${height}`;
  box.style.setProperty("--ratio", width / height); // the style sheet fits it into its place
  const waits = [];
  for (let row = 0; row * TILE_PX < height; row++) {
    for (let column = 0; column * TILE_PX < width; column++) {
      const tile = make("img", { alt: "", src: tileOfRun(run, mosaic, fullLevel(mosaic) - reduction, column, row) });
      Object.assign(tile.style, {
        left: `${(column * TILE_PX * 100) / width}%`, top: `${(row * TILE_PX * 100) / height}%`,
        width: `${(Math.min(TILE_PX, width - column * TILE_PX) * 100) / width}%`,
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
