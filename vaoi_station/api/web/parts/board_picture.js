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

// The box around points in CAD coordinates, [x0, y0, x1, y1] in pixels of a mosaic, with a margin in its own sizes.
export function boxOf(mosaic, points, margin = 0) {
  const places = points.map((point) => toPicture(mosaic.image_from_cad, point));
  const [low, high] = [Math.min, Math.max].map((most) => [0, 1].map((n) => most(...places.map((place) => place[n]))));
  const [w, h] = [margin * (high[0] - low[0]), margin * (high[1] - low[1])];
  return [low[0] - w, low[1] - h, high[0] + w, high[1] + h];
}

const REGION_PX = 240; // a region is shown at least as large, if its pixels suffice

// Resolves to an element, or to null if there is no mosaic. `steps`: how often the smallest level is doubled. `region`: only this part,
// [x0, y0, x1, y1] in pixels of the mosaic.
export async function boardPicture(run, { steps = 1, alt = "", mosaic = null, region = null } = {}) {
  if (run.verdict === "failed" || run.verdict == null || (!run.frames_available && !run.recording)) return null;
  mosaic ??= (await rest.mosaics(run.id))[0];
  if (!mosaic) return null;
  const [x0, y0, x1, y1] = region ?? [0, 0, mosaic.width_px, mosaic.height_px];
  const least = region ? Math.floor(Math.log2(Math.max(x1 - x0, y1 - y0) / REGION_PX)) : mosaic.levels - 1 - steps;
  const reduction = Math.min(Math.max(least, 0), mosaic.levels - 1);
  const [left, top, width, height] = [x0, y0, x1 - x0, y1 - y0].map((px) => px / 2 ** reduction);
  const [across, down] = [mosaic.width_px, mosaic.height_px].map((side) => Math.ceil(side / 2 ** reduction));
  const box = make("div", { className: "board-picture", ...(alt ? { role: "img", ariaLabel: alt } : { ariaHidden: "true" }) });
  box.style.aspectRatio = `${width} / ${height}`;
  box.style.setProperty("--ratio", width / height); // the style sheet fits it into its place
  const waits = [];
  for (let row = Math.max(Math.floor(top / TILE_PX), 0); row * TILE_PX < Math.min(top + height, down); row++) {
    for (let column = Math.max(Math.floor(left / TILE_PX), 0); column * TILE_PX < Math.min(left + width, across); column++) {
      const tile = make("img", { alt: "", src: tileOfRun(run, mosaic, fullLevel(mosaic) - reduction, column, row) });
      Object.assign(tile.style, {
        left: `${((column * TILE_PX - left) * 100) / width}%`, top: `${((row * TILE_PX - top) * 100) / height}%`,
        width: `${(Math.min(TILE_PX, across - column * TILE_PX) * 100) / width}%`,
      });
      waits.push(tile.decode().catch(() => tile.remove()));
      box.append(tile);
    }
  }
  if (run.unseen?.length && !region) box.append(await hatched(run, mosaic));
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
