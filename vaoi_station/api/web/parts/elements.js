// Small helpers to make and change elements.
export const $ = (id) => document.getElementById(id);

export function make(name, fields = {}, ...children) {
  const element = Object.assign(document.createElement(name), fields);
  element.append(...children);
  return element;
}

// Screen readers announce a live region whenever its text is set, so it is set only when it changes.
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export function showLines(list, lines) {
  const wanted = JSON.stringify(lines);
  if (wanted === list.dataset.shown) return;
  list.dataset.shown = wanted;
  list.replaceChildren(...lines.map((line) => make("li", { textContent: line })));
}
