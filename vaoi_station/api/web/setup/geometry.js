// The geometry of board types: footprints, and data that are moved by hand. Coordinates are in the unit and axes of the board type.
const MM = { mm: 1, inch: 25.4, mil: 0.0254 };
export const mmPerUnit = (type) => MM[type.unit ?? "mm"];
const up = (type) => (type.y_axis === "down" ? -1 : 1);

const turned = ([x, y], radians) => [Math.cos(radians) * x - Math.sin(radians) * y, Math.sin(radians) * x + Math.cos(radians) * y];

// The four corners of a component's body. Rotations are counter-clockwise as seen from the top, whether y points up or down.
export function footprint(type, part) {
  const angle = (up(type) * (part.rotation ?? 0) * Math.PI) / 180;
  return [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([a, b]) => {
    const [x, y] = turned([(a * part.width) / 2, (b * part.height) / 2], angle);
    return [part.center[0] + x, part.center[1] + y];
  });
}

// All corners of the outline, of which a rectangle states two; without one, the box around all parts and fiducials.
export function outlineOf(type) {
  if (type.outline?.length > 2) return type.outline;
  const points = type.outline ?? [...(type.fiducials ?? []).map((f) => [f.x, f.y]), ...(type.components ?? []).flatMap((part) => footprint(type, part))];
  const [[x0, y0], [x1, y1]] = extent(points.length ? points : [[0, 0], [1, 1]]);
  return [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
}

export function extent(points) {
  let [x0, y0, x1, y1] = [Infinity, Infinity, -Infinity, -Infinity];
  for (const [x, y] of points) [x0, y0, x1, y1] = [Math.min(x0, x), Math.min(y0, y), Math.max(x1, x), Math.max(y1, y)];
  return [[x0, y0], [x1, y1]];
}

export const address = (part) => (part.panel == null ? part.ref : `${part.panel}/${part.ref}`);

// The middle of the components, about which they are turned.
export function middle(type) {
  const [low, high] = extent((type.components ?? []).map((part) => part.center));
  return [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
}

// A move by hand: x and y in mm as seen from the top with y up, a turn in degrees counter-clockwise; as the place where it leads a point.
export function mover(type, { x, y, turn }) {
  const [mx, my] = middle(type);
  const angle = (up(type) * turn * Math.PI) / 180;
  const shift = [x / mmPerUnit(type), (up(type) * y) / mmPerUnit(type)];
  return ([px, py]) => {
    const [dx, dy] = turned([px - mx, py - my], angle);
    return [mx + dx + shift[0], my + dy + shift[1]];
  };
}

// A draft of the board type with its components, and if wanted its outline, moved.
export function moved(type, move, withOutline) {
  const digits = 4 + Math.round(Math.log10(mmPerUnit(type)));
  const lead = mover(type, move);
  const at = (point) => lead(point).map((value) => Number(value.toFixed(digits)));
  const components = type.components.map((part) => ({
    ...part, center: at(part.center), rotation: Number(((((part.rotation ?? 0) + move.turn) % 360 + 360) % 360).toFixed(4)),
    ...(part.origin ? { origin: at(part.origin) } : {}),
  }));
  const points = type.test_points?.x.map((x, n) => at([x, type.test_points.y[n]]));
  const probed = points ? { test_points: { ...type.test_points, x: points.map(([x]) => x), y: points.map(([, y]) => y) } } : {};
  const around = withOutline && type.outline ? { outline: outlineOf(type).map(at), ...(type.cut_outs ? { cut_outs: type.cut_outs.map((c) => c.map(at)) } : {}) } : {};
  return { ...type, ...around, ...probed, components, state: "draft", revision: `${(type.revision ?? "").slice(0, 30)} moved`.trim() };
}
