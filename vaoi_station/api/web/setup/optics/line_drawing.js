// A planned line to scale, in mm: the fields of all rows over the board from above, and the cameras seen along the motion.
import { make } from "../../parts/elements.js";
import { svg, titled } from "../../parts/svg.js";
import { number, texts } from "../../texts/texts.js";
import { roundLength } from "../drawing.js";
import { PanZoom } from "../pan_zoom.js";

const MOST_FIELDS = 2000; // more can no longer be distinguished, and are slow to draw
const MOST_CAMERAS = 400;
const ROWS_WITHOUT_LENGTH = 3;

// Fields and rows of a plan, in mm: the board begins at 0, 0; x lies across the motion.
function layoutOf(plan) {
  const { requirements: asked, array, motion, data } = plan;
  const [width, field, height] = [asked.width_mm, array.field_width_mm, array.field_height_mm];
  const rows = data.rows ?? ROWS_WITHOUT_LENGTH + Math.ceil(height / motion.row_step_mm);
  const length = asked.longest_board_mm ?? Math.max((rows - 1) * motion.row_step_mm - height, height);
  const centers = Array.from({ length: Math.min(array.cameras, MOST_CAMERAS) }, (_, i) => width / 2 + (i - (array.cameras - 1) / 2) * array.camera_pitch_mm);
  const tops = (j) => length / 2 + (j - (rows - 1) / 2) * motion.row_step_mm - height / 2;
  return { width, length, field, height, rows, centers, tops, overlap: field - array.camera_pitch_mm };
}

export function lineDrawing(plan) {
  const t = texts.optics;
  const at = layoutOf(plan);
  const { lens, requirements: asked, array, motion } = plan;
  const up = Math.max(lens.working_distance_mm, asked.distance_max_mm);
  const left = Math.min(0, at.centers[0] - at.field / 2);
  const span = Math.max(at.width, at.centers.at(-1) + at.field / 2) - left;
  const [top, bottom] = [Math.min(0, at.tops(0)), Math.max(at.length, at.tops(at.rows - 1) + at.height)];
  const tall = Math.max(bottom - top, up);
  const margin = 0.05 * Math.max(2 * span, tall);
  const letters = 0.8 * margin;
  const bar = roundLength((span + margin) / 2);
  const label = (x, y, text) => Object.assign(svg("text", { x, y, "font-size": letters, class: "label" }), { textContent: text });
  const whole = [left - margin, top - 2 * margin, 2 * span + 4 * margin, tall + 5 * margin];
  const drawing = svg("svg", { class: "line-drawing", role: "img" },
    label(left, top - margin / 2, t.fromAbove), fromAbove(at, motion.row_step_mm, margin),
    label(left + span + 2 * margin, top - margin / 2, t.fromSide),
    fromSide(at, { x: span + 2 * margin, ground: top + tall, high: asked.distance_max_mm, low: asked.distance_min_mm, d: lens.working_distance_mm, part: asked.depth_of_field_mm, margin }),
    svg("path", { d: `M${left} ${top + tall + margin}h${bar}`, class: "scale" }));
  drawing.setAttribute("aria-label", t.drawingOf(array.cameras, number(at.width, 1), number(at.length, 1), number(lens.working_distance_mm, 0)));
  const pan = new PanZoom(drawing, whole);
  const names = ["one-row", "next-row", at.overlap < 0 && array.cameras > 1 ? "gap" : "overlap", "limit"];
  const legend = make("ul", { className: "legend" }, ...names.map((name) => make("li", { className: name, textContent: t.legend[name] })));
  const size = make("span", { className: "size", textContent: t.bar(number(bar, bar < 1 ? 2 : 0)) });
  return make("div", { className: "drawing" }, make("div", { className: "drawing-tools" }, size, ...pan.tools), drawing, legend);
}

// All fields lie over one another in a faint colour: the darker, the more often a place is filmed. One row and the next are outlined.
function fromAbove(at, step, margin) {
  const box = (x, y, width, height, kind) => svg("rect", { x, y, width, height, class: kind });
  const parts = [box(0, 0, at.width, at.length, "optics-board")];
  const row = (y, kind) => at.centers.map((x) => box(x - at.field / 2, y, at.field, at.height, kind));
  if (at.rows * at.centers.length <= MOST_FIELDS) for (let j = 0; j < at.rows; j++) parts.push(...row(at.tops(j), "optics-view"));
  const middle = at.tops(Math.floor((at.rows - 1) / 2));
  parts.push(...row(middle + step, "next-row"), ...row(middle, "one-row"));
  for (let i = 1; i < at.centers.length; i++) {
    const [from, to] = [at.centers[i] - at.field / 2, at.centers[i - 1] + at.field / 2];
    if (to > from) parts.push(box(from, middle, to - from, at.height, "overlap"));
    else if (from > to) parts.push(box(to, 0, from - to, at.length, "gap"));
  }
  const [x, y] = [at.width / 2, at.length + margin * 0.2];
  parts.push(svg("path", { d: `M${x} ${y}v${0.9 * margin}m${-0.3 * margin} ${-0.3 * margin}l${0.3 * margin} ${0.3 * margin}l${0.3 * margin} ${-0.3 * margin}`, class: "motion" }));
  return svg("g", {}, ...parts);
}

function fromSide(at, { x, ground, high, low, d, part, margin }) {
  const line = (y, kind) => svg("path", { d: `M0 ${y}h${at.width}`, class: kind });
  const cones = at.centers.map((center, i) => titled(svg("path", { d: `M${center} ${ground - d}L${center - at.field / 2} ${ground}H${center + at.field / 2}Z`, class: "cone" }), texts.optics.camera(i)));
  const bodies = at.centers.map((center) => svg("circle", { cx: center, cy: ground - d, r: 0.12 * margin, class: "optics-camera" }));
  const parts = part ? [svg("rect", { x: 0, y: ground - part, width: at.width, height: part, class: "optics-part" })] : [];
  const limits = [high, low].filter(Boolean).map((value) => line(ground - value, "limit"));
  return svg("g", { transform: `translate(${x} 0)` }, ...parts, ...cones, ...bodies, ...limits, line(ground, "belt"));
}
