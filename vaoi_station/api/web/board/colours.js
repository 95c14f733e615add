// What parts are coloured by: classes of σ, of the number of views, and of heights, each with its colour and its line.
// The colours differ in lightness too, and every class has a line of its own: none depends on colour alone.
import { number, texts } from "../texts/texts.js";

const SIGMA_PX = [0.05, 0.1, 0.2, 0.5]; // 0.2 px is the limit of the verdict
const VIEWS = [0, 1, 2, 4];

function sigmaOf(part) {
  if (part.sigma_px == null) return { key: "none", text: texts.board.noValue, rank: -1 };
  const n = SIGMA_PX.findIndex((limit) => part.sigma_px <= limit);
  const text = `σ ${number(part.sigma_px, 3)} px = ${number(part.sigma_mm * 1000, 1)} µm`;
  return { key: `c${n < 0 ? SIGMA_PX.length : n}`, text, rank: part.sigma_px };
}

function viewsOf(part) {
  const n = VIEWS.findLastIndex((least) => part.views >= least);
  return { key: `v${n}`, text: texts.views(part.views), rank: -part.views };
}

function heightOf(part, heights) {
  const entry = heights?.[part.address];
  const key = entry?.comparison ?? "none";
  const text = entry ? heightText(entry) : texts.board.noValue;
  return { key, text, rank: ["higher", "lower"].includes(key) ? 2 : ["ambiguous", "unknown"].includes(key) ? 1 : 0 };
}

const rangeText = ({ low_mm, high_mm }) => `${number(low_mm, 2)} … ${number(high_mm, 2)} mm`;

function intervalsText(entry) {
  const each = entry.intervals?.map((interval) => `${rangeText(interval)} (${number(100 * interval.probability, 0)} %)`);
  return each?.join(texts.board.or) ?? rangeText(entry);
}

export function heightText(entry) {
  const measured = entry.height_mm != null ? `${number(entry.height_mm, 2)} ± ${number(entry.sigma_mm, 2)} mm`
    : entry.low_mm != null ? intervalsText(entry) : texts.board.noValue;
  const expected = entry.expected_mm != null ? `, ${texts.board.expected} ${number(entry.expected_mm, 2)} mm` : "";
  return `${measured}${expected}${entry.comparison ? `: ${texts.board.heights[entry.comparison]}` : ""}`;
}

// The class of a part: key of its style, what it says, and a rank, the largest of which is the worst.
export function classOf(colour, part, heights) {
  return colour === "sigma" ? sigmaOf(part) : colour === "views" ? viewsOf(part) : colour === "height" ? heightOf(part, heights) : null;
}

// The classes of a colouring, best first, as [key, label].
export function classes(colour) {
  if (colour === "sigma") {
    const px = SIGMA_PX.map((limit) => `≤ ${number(limit, 2)}`);
    return [...px.map((label, n) => [`c${n}`, label]), [`c${SIGMA_PX.length}`, `> ${number(SIGMA_PX.at(-1), 2)} px`], ["none", texts.board.noValue]];
  }
  if (colour === "views") return [["v3", "≥ 4"], ["v2", "2, 3"], ["v1", "1"], ["v0", "0"]];
  if (colour === "height") return ["agrees", "unknown", "ambiguous", "lower", "higher"].map((key) => [key, texts.board.heights[key]]).concat([["none", texts.board.noValue]]);
  return [];
}

// The parts in the order in which an engineer goes through them: the worst first, by name where they are alike.
export function worstFirst(colour, parts, heights) {
  const rank = (part) => classOf(colour, part, heights)?.rank ?? 0;
  const byName = new Intl.Collator("en", { numeric: true }).compare;
  return [...parts].sort((a, b) => rank(b) - rank(a) || byName(a.address, b.address));
}
