// What parts are coloured by: classes of σ, of the number of views, of heights, and of what is measured of parts, each with its colour and
// its line.
// The colours differ in lightness too, and every class has a line of its own: none depends on colour alone.
import { number, texts } from "../texts/texts.js";

const SIGMA_PX = [0.05, 0.1, 0.2, 0.5]; // 0.2 px is the limit of the verdict
const VIEWS = [0, 1, 2, 4];
const LIMITS = { shift: [0.05, 0.1, 0.2, 0.5], turn: [1, 2, 5, 10] }; // mm, degrees
const PROBABLE = ["agrees", "ambiguous", "lower"]; // at least 0.99, at least 0.5, less
export const COLOURS = ["none", "sigma", "views", "height", "presence", "shift", "turn", "orientation", "alike"];

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

const UNIT = { shift: " mm", turn: "°" };
const percent = (p) => `${number(100 * p, p > 0.99 && p < 1 ? 1 : 0)} %`;

// The figures of a measured part; null where nothing can be said.
export const VALUES = {
  presence: (measure) => measure.presence,
  shift: (measure) => (measure.dx_mm == null ? null : Math.hypot(measure.dx_mm, measure.dy_mm)),
  turn: (measure) => (measure.turn_deg == null ? null : Math.abs(measure.turn_deg)),
  orientation: (measure) => measure.orientation?.["0"] ?? null,
  alike: (measure) => measure.alike,
};

const TEXTS = {
  presence: (measure) => percent(measure.presence),
  shift: (measure) => `${number(measure.dx_mm, 3)}, ${number(measure.dy_mm, 3)} ± ${number(measure.sigma_mm, 3)} mm`,
  turn: (measure) => `${number(measure.turn_deg, 1)} ± ${number(measure.sigma_deg, 1)}°`,
  orientation: (measure) => Object.entries(measure.orientation).map(([turn, p]) => `${turn}°: ${percent(p)}`).join(", "),
  alike: (measure) => percent(measure.alike),
};

export const measureText = (name, measure) => (VALUES[name](measure) == null ? texts.board.cannotSay : TEXTS[name](measure));

function measureOf(name, measure) {
  const value = measure ? VALUES[name](measure) : null;
  if (value == null) return { key: "none", text: measure ? texts.board.cannotSay : texts.board.noValue, rank: -1 };
  const text = measureText(name, measure);
  if (!LIMITS[name]) return { key: PROBABLE[value >= 0.99 ? 0 : value >= 0.5 ? 1 : 2], text, rank: 1 - value };
  const n = LIMITS[name].findIndex((limit) => value <= limit);
  return { key: `c${n < 0 ? LIMITS[name].length : n}`, text, rank: value };
}

// The class of a part: key of its style, what it says, and a rank, the largest of which is the worst. `measured`: what is known of all
// parts, heights and measures by address, or null.
export function classOf(colour, part, { heights, measures }) {
  if (VALUES[colour]) return measureOf(colour, measures?.[part.address]);
  return colour === "sigma" ? sigmaOf(part) : colour === "views" ? viewsOf(part) : colour === "height" ? heightOf(part, heights) : null;
}

// The classes of a colouring, best first, as [key, label].
export function classes(colour) {
  if (colour === "sigma") return limited(SIGMA_PX, 2, " px", texts.board.noValue);
  if (LIMITS[colour]) return limited(LIMITS[colour], colour === "shift" ? 2 : 0, UNIT[colour], texts.board.cannotSay);
  if (VALUES[colour]) return [...PROBABLE.map((key, n) => [key, texts.board.probable[colour][n]]), ["none", texts.board.cannotSay]];
  if (colour === "views") return [["v3", "≥ 4"], ["v2", "2, 3"], ["v1", "1"], ["v0", "0"]];
  if (colour === "height") return ["agrees", "unknown", "ambiguous", "lower", "higher"].map((key) => [key, texts.board.heights[key]]).concat([["none", texts.board.noValue]]);
  return [];
}

const limited = (limits, digits, unit, none) => [
  ...limits.map((limit, n) => [`c${n}`, `≤ ${number(limit, digits)}`]), [`c${limits.length}`, `> ${number(limits.at(-1), digits)}${unit}`], ["none", none],
];

// The parts in the order in which an engineer goes through them: the worst first, by name where they are alike.
export function worstFirst(colour, parts, measured) {
  const rank = (part) => classOf(colour, part, measured)?.rank ?? 0;
  const byName = new Intl.Collator("en", { numeric: true }).compare;
  return [...parts].sort((a, b) => rank(b) - rank(a) || byName(a.address, b.address));
}
