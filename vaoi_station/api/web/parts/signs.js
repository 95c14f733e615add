// Shapes that distinguish states without colour. Each is the content of an SVG with viewBox 0 0 100 100.
import { svg } from "./svg.js";

const line = 'fill="none" stroke="currentColor" stroke-width="8" stroke-linecap="round" stroke-linejoin="round"';
const ring = `<circle cx="50" cy="50" r="42" ${line}/>`;
const dashed = `<circle cx="50" cy="50" r="42" ${line} stroke-dasharray="20 24"/>`;
const triangle = `<path d="M50 8 96 90H4Z" ${line}/><path d="M50 36v26M50 76v1" ${line}/>`;
const octagon =
  '<path d="M31 4h38l27 27v38L69 96H31L4 69V31Z" fill="currentColor"/>' +
  '<path d="M35 35 65 65M65 35 35 65" fill="none" stroke="var(--panel)" stroke-width="10" stroke-linecap="round"/>';

const marks = {
  starting: dashed,
  idle: `${ring}<path d="M38 34v32M62 34v32" ${line}/>`,
  arming: dashed,
  armed: `<circle cx="50" cy="50" r="46" fill="currentColor"/><path d="M30 52 44 66 71 36" fill="none" stroke="var(--panel)" stroke-width="10" stroke-linecap="round" stroke-linejoin="round"/>`,
  filming: `<rect x="6" y="26" width="88" height="58" rx="8" fill="currentColor"/><path d="M34 26 41 12h18l7 14Z" fill="currentColor"/><circle cx="50" cy="55" r="18" fill="none" stroke="var(--panel)" stroke-width="8"/>`,
  blocked: triangle,
  lacking: triangle,
  held: triangle,
  uncalibrated: triangle,
  faulted: octagon,
  stopping: `<rect x="14" y="14" width="72" height="72" rx="6" ${line}/>`,
  unknown: `${dashed}<path d="M50 72v1M38 38a12 12 0 1 1 18 12q-6 3-6 9" ${line}/>`,
  ok: `${ring}<path d="M30 52 44 66 71 36" ${line}/>`,
  degraded: triangle,
  failed: octagon,
  none: dashed,
  missed: `<path d="M14 30h72v52H14Z" ${line} stroke-dasharray="14 14"/><path d="M30 44 70 70M70 44 30 70" ${line}/>`,
};

export function draw(svg, name) {
  const shape = marks[name] ?? marks.unknown;
  if (svg.dataset.mark === name) return;
  svg.dataset.mark = name;
  svg.innerHTML = shape;
}

// A sign by itself, for lists.
export function sign(name) {
  const shape = svg("svg", { viewBox: "0 0 100 100", "aria-hidden": "true" });
  draw(shape, name);
  return shape;
}
