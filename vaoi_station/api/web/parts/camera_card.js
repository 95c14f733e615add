// What a frame shows of its camera: sharpness over the field, and the histogram with what is clipped.
import { svg } from "./svg.js";

export const BLUR_LIMIT_PX = 1.3; // limits of a good picture
export const SATURATED_LIMIT = 0.005;
export const DARK_LIMIT = 0.35;
const WIDTH = 300;
const HEIGHT = 60;

// The 3 × 3 parts of the field with their blur, to lie over the picture. `say`: the text of a blur in px.
export function sharpnessMap(tiles, say) {
  const map = svg("svg", { class: "sharpness", viewBox: "0 0 300 300", preserveAspectRatio: "none", "aria-hidden": "true" });
  for (const { column, row, blur_px } of tiles) {
    const soft = blur_px != null && blur_px > BLUR_LIMIT_PX;
    map.append(svg("rect", { x: column * 100, y: row * 100, width: 100, height: 100, class: soft ? "soft" : "sharp" }));
  }
  const words = tiles.map(({ column, row, blur_px }) => {
    const word = document.createElement("span");
    word.textContent = blur_px == null ? "–" : say(blur_px);
    word.className = blur_px != null && blur_px > BLUR_LIMIT_PX ? "soft" : "";
    Object.assign(word.style, { gridColumn: column + 1, gridRow: row + 1 });
    return word;
  });
  const box = document.createElement("div");
  box.className = "sharpness-words";
  box.append(...words);
  return [map, box];
}

// Shares of the pixels by grey level, dark to the left. The last step is marked if more of it is clipped than may be.
export function histogram(shares, saturated, label) {
  const picture = svg("svg", { class: "histogram", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, preserveAspectRatio: "none", role: "img", "aria-label": label });
  const most = Math.max(...shares.slice(0, -1), 0.01); // a clipped peak must not flatten the others
  const step = WIDTH / shares.length;
  shares.forEach((share, n) => {
    const height = Math.min(share / most, 1) * HEIGHT;
    const clipped = n === shares.length - 1 && saturated > SATURATED_LIMIT;
    picture.append(svg("rect", { x: n * step, y: HEIGHT - height, width: step, height, class: clipped ? "clipped" : "level" }));
  });
  return picture;
}
