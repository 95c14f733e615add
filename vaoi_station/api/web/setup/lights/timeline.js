// A light program to scale: above, the rows in their periods; below, each row enlarged, with its LEDs, exposures and blur limits.
import { svg, titled } from "../../parts/svg.js";
import { number, texts } from "../../texts/texts.js";

const [WIDTH, LEFT, RIGHT] = [1000, 170, 20];
const [STRIP, LANE, GAP] = [70, 20, 16];
const NICE = [1, 2, 5];

const micros = (us) => (us >= 10_000 ? `${number(us / 1000, us % 1000 ? 1 : 0)} ms` : `${number(us, us % 1 ? 1 : 0)} µs`);
const text = (x, y, content, fields = {}) => Object.assign(svg("text", { x, y, ...fields }), { textContent: content });

// The distance of the ticks of an axis of this length: at most `most` of them.
function tickStep(length, most) {
  const power = 10 ** Math.floor(Math.log10(length / most));
  return power * (NICE.find((n) => (n * power * most) >= length) ?? 10);
}

// Lanes with the same values are one: cameras that expose alike have one bar.
function lanes(step, cameras) {
  const found = [];
  cameras.forEach((camera, n) => {
    const known = found.find((lane) => lane.us === step.exposures_us[n] && lane.limit === camera.longest_lit_us);
    if (known) known.cameras.push(camera.name);
    else found.push({ cameras: [camera.name], us: step.exposures_us[n], lit: step.lit_us[n], limit: camera.longest_lit_us });
  });
  return found;
}

export function timeline(check) {
  const t = texts.lights;
  const period = check.period_s * 1e6;
  const rows = check.steps.map((step) => ({ step, lanes: lanes(step, check.cameras) }));
  // LEDs and exposures decide the scale; a limit that lies far beyond them is only named.
  const longest = Math.max(1, ...rows.flatMap(({ step, lanes: all }) => [step.on_us ?? 0, ...all.map((lane) => lane.us)]));
  const shown = longest * 1.25;
  const height = STRIP + 40 + rows.reduce((sum, row) => sum + 26 + (row.lanes.length + 1) * LANE + GAP, 0) + 34;
  const drawing = svg("svg", { viewBox: `0 0 ${WIDTH} ${height}`, role: "img", class: "program-timeline", "aria-label": t.timelineAlt(rows.length, micros(period)) });
  drawing.append(strip(check, rows, period));
  drawing.append(text(0, STRIP + 26, t.enlarged(number((period * rows.length) / shown)), { class: "note" }));
  let y = STRIP + 40;
  for (const [n, row] of rows.entries()) y = enlarged(drawing, check, n, row, y, shown);
  axis(drawing, y, shown);
  return drawing;
}

const along = (us, whole) => LEFT + (us / whole) * (WIDTH - LEFT - RIGHT);

// All rows of one turn in their periods, with the longest exposure and read-out of each.
function strip(check, rows, period) {
  const t = texts.lights;
  const whole = period * rows.length;
  const group = svg("g", { class: "strip" }, text(0, 34, t.everyPeriod(micros(period)), { class: "name" }));
  rows.forEach(({ step }, n) => {
    const begin = along(n * period, whole);
    const used = Math.max(...step.exposures_us.map((us, camera) => us + check.cameras[camera].readout_us));
    group.append(svg("rect", { x: begin, y: 20, width: along(period, whole) - LEFT, height: 26, class: "period" }));
    group.append(titled(svg("rect", { x: begin, y: 20, width: Math.max(1.5, along(used, whole) - LEFT), height: 26, class: "busy" }), `${t.row(n)}: ${micros(used)}`));
    // Many rows leave no room for the number of each.
    if (rows.length <= 24) group.append(text(begin + 4, 64, String(n), { class: "note" }));
  });
  return group;
}

function bar(us, whole, y, kind, wrong, label) {
  const width = Math.max(1.5, along(us, whole) - LEFT);
  const made = svg("g", { class: wrong ? `${kind} wrong` : kind }, svg("rect", { x: LEFT, y: y + 3, width, height: LANE - 6 }));
  made.append(text(Math.min(LEFT + width + 6, WIDTH - 90), y + LANE - 5, wrong ? `${label} ✕` : label, { class: "value" }));
  return titled(made, label);
}

function enlarged(drawing, check, n, { step, lanes: all }, top, whole) {
  const t = texts.lights;
  const wrong = (field, camera) => check.faults.some((fault) => fault.step === n && fault.field === field && (camera === undefined || fault.camera === undefined || fault.camera === camera));
  const limits = all.map((lane) => lane.limit).filter((us) => us !== undefined);
  const least = limits.length ? ` – ${t.blurLimit(micros(Math.min(...limits)), number(check.max_blur_px, 1))}` : "";
  drawing.append(text(0, top + 18, `${t.of(t.row(n), step.light)}${least}`, { class: "title" }));
  let y = top + 26;
  drawing.append(text(0, y + LANE - 5, t.leds, { class: "name" }));
  drawing.append(bar(step.on_us ?? Math.max(...step.exposures_us), whole, y, "lit", wrong("on_us"), step.on_us === undefined ? t.wholeExposure : micros(step.on_us)));
  y += LANE;
  for (const lane of all) {
    const numbers = lane.cameras.map((name) => check.cameras.findIndex((camera) => camera.name === name));
    const label = lane.cameras.length > 2 ? `${lane.cameras[0]} … ${lane.cameras.at(-1)}` : lane.cameras.join(", ");
    drawing.append(titled(text(0, y + LANE - 5, label.length > 20 ? `${label.slice(0, 19)}…` : label, { class: "name" }), lane.cameras.join(", ")));
    drawing.append(bar(lane.us, whole, y, "exposed", numbers.some((camera) => wrong("exposure_us", camera)), micros(lane.us)));
    if (lane.limit !== undefined && lane.limit <= whole) drawing.append(limit(lane.limit, whole, y, check.max_blur_px));
    y += LANE;
  }
  return y + GAP;
}

function limit(us, whole, y, blur) {
  const x = along(us, whole);
  return titled(svg("line", { x1: x, x2: x, y1: y - LANE, y2: y + LANE, class: "limit" }), texts.lights.blurLimit(micros(us), number(blur, 1)));
}

function axis(drawing, y, whole) {
  const step = tickStep(whole, 6);
  const line = svg("g", { class: "axis" }, svg("line", { x1: LEFT, x2: WIDTH - RIGHT, y1: y, y2: y }));
  for (let at = 0; at <= whole; at += step) {
    const x = along(at, whole);
    line.append(svg("line", { x1: x, x2: x, y1: y, y2: y + 6 }), text(x, y + 24, micros(at), { class: "note", "text-anchor": at ? "middle" : "start" }));
  }
  drawing.append(line);
}
