// Elements of SVG.
const SVG = "http://www.w3.org/2000/svg";

export function svg(name, fields = {}, ...children) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(fields)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

// An element with a text that appears when the pointer rests on it.
export function titled(element, text) {
  element.append(Object.assign(document.createElementNS(SVG, "title"), { textContent: text }));
  return element;
}
