// What a frame shows of its camera: sharpness over the field, and the histogram with what is clipped.
import { number, texts } from "../texts/texts.js";
import { make } from "./elements.js";
import { svg } from "./svg.js";

export const BLUR_LIMIT_PX = 1.3; // limits of a good picture
export const SATURATED_LIMIT = 0.005;
export const DARK_LIMIT = 0.35;
const WIDTH = 300;
const HEIGHT = 60;
export const px = (value) => number(value, 2);
export const percent = (share, digits = 0) => `${number(100 * share, digits)} %`;

// Show a frame in the elements `picture`, `blur` and `levels` of a card. A frame whose memory was given to a later board is not shown:
// false.
export async function showFrame(card, frame, src, alt) {
  const words = texts.cameras;
  const image = make("img", { src, alt });
  await image.decode().catch(() => {});
  if (!image.naturalWidth) return false;
  card.picture.style.aspectRatio = `${frame.width} / ${frame.height}`;
  card.picture.replaceChildren(image, ...sharpnessMap(frame.tiles));
  card.blur.replaceChildren(...(frame.blur_px == null ? [words.noEdges] : [make("b", { textContent: px(frame.blur_px) }), ` ${words.blur}`]));
  const label = words.histogram(percent(frame.low), percent(frame.high), percent(frame.saturated, 2));
  card.levels.replaceChildren(histogram(frame.histogram, frame.saturated, label), make("p", { textContent: label }));
  return true;
}

// The 3 × 3 parts of the field with their blur, to lie over the picture.
function sharpnessMap(tiles) {
  const map = svg("svg", { class: "sharpness", viewBox: "0 0 300 300", preserveAspectRatio: "none", "aria-hidden": "true" });
  for (const { column, row, blur_px } of tiles) {
    map.append(svg("rect", { x: column * 100, y: row * 100, width: 100, height: 100, class: blur_px > BLUR_LIMIT_PX ? "soft" : "sharp" }));
  }
  const words = tiles.map(({ column, row, blur_px }) => {
    const word = make("span", { textContent: blur_px == null ? "–" : px(blur_px), className: blur_px > BLUR_LIMIT_PX ? "soft" : "" });
    Object.assign(word.style, { gridColumn: column + 1, gridRow: row + 1 });
    return word;
  });
  return [map, make("div", { className: "sharpness-words" }, ...words)];
}

// Shares of the pixels by grey level, dark to the left. The last step is marked if more of it is clipped than may be.
function histogram(shares, saturated, label) {
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
