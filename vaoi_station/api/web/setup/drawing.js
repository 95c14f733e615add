// A board type drawn to scale: outline, cut-outs, bodies, fiducials, and a bar of a round length. A bottom side is drawn as it is seen.
import { make } from "../parts/elements.js";
import { svg, titled } from "../parts/svg.js";
import { number, texts } from "../texts/texts.js";
import { address, extent, footprint, mmPerUnit, outlineOf } from "./geometry.js";
import { PanZoom } from "./pan_zoom.js";

const MOST_LABELS = 400;

const path = (polygons) => polygons.map((points) => `M${points.map((p) => p.map((v) => +v.toFixed(5)).join(" ")).join("L")}Z`).join("");

// The shapes of the parts, one element each, so that each has its name and can be chosen.
export function bodies(type, onChoose) {
  return (type.components ?? []).map((part) => {
    const shape = titled(svg("path", { d: path([footprint(type, part)]), class: `body${part.size_from === "guess" ? " guess" : ""}${part.fitted === false ? " unfitted" : ""}` }), address(part));
    shape.dataset.address = address(part);
    if (onChoose) shape.addEventListener("click", () => onChoose(part));
    return shape;
  });
}

// A length of 1, 2 or 5 times a power of ten near `wanted`.
export function roundLength(wanted) {
  const power = 10 ** Math.floor(Math.log10(wanted));
  return [5, 2, 1].map((n) => n * power).find((length) => length <= wanted) ?? power;
}

export function boardDrawing(type, { onChoose } = {}) {
  const [sx, sy] = [type.side === "bottom" ? -1 : 1, type.y_axis === "down" ? 1 : -1];
  const unit = mmPerUnit(type);
  const others = [...(type.fiducials ?? []), ...(type.other_marks ?? [])].map((mark) => [mark.x, mark.y]);
  const [low, high] = extent([...outlineOf(type), ...others]);
  const [width, height] = [high[0] - low[0], high[1] - low[1]];
  const margin = 0.04 * Math.max(width, height);
  const [left, top] = [sx > 0 ? low[0] : -high[0], sy > 0 ? low[1] : -high[1]];
  const dots = (list, kind) => list.map((mark) => {
    const dot = titled(svg("circle", { cx: mark.x, cy: mark.y, r: mark.diameter / 2, class: `${kind}${mark.kind ? ` ${mark.kind}` : ""}` }), mark.name);
    const ring = svg("circle", { cx: mark.x, cy: mark.y, r: mark.diameter / 2 + margin / 3, class: `${kind}-ring` });
    return svg("g", {}, dot, ring);
  });
  const labels = (type.components ?? []).length > MOST_LABELS ? [] : (type.components ?? []).map((part) => {
    const size = Math.min(0.45 * Math.min(part.width, part.height), (1.4 * Math.max(part.width, part.height)) / address(part).length);
    const text = svg("text", { x: sx * part.center[0], y: sy * part.center[1], "font-size": size, class: "ref", "dominant-baseline": "central" });
    text.textContent = address(part);
    return text;
  });
  const bar = roundLength((width * unit) / 3);
  const scale = [svg("path", { d: `M${left} ${top + height + margin}h${bar / unit}`, class: "scale" })];
  const drawing = svg("svg", { class: "board-drawing", role: "img" },
    svg("g", { transform: `scale(${sx} ${sy})` },
      svg("path", { d: path([outlineOf(type), ...(type.cut_outs ?? [])]), class: `outline${type.outline ? "" : " unstated"}` }),
      ...bodies(type, onChoose), ...dots(type.fiducials ?? [], "mark"), ...dots(type.other_marks ?? [], "other")),
    ...labels, ...scale);
  drawing.setAttribute("aria-label", texts.setup.drawingOf(type.name, number(width * unit, 1), number(height * unit, 1)));
  const pan = new PanZoom(drawing, [left - margin, top - margin, width + 2 * margin, height + 3 * margin]);
  const size = make("span", { className: "size", textContent: texts.setup.drawingSize(number(width * unit, 2), number(height * unit, 2), number(bar, bar < 1 ? 2 : 0)) });
  return make("div", { className: "drawing" }, make("div", { className: "drawing-tools" }, size, ...pan.tools), drawing);
}
