// Which marks place the board: those that the data name, and any part that a person names a fiducial.
import { make } from "../parts/elements.js";
import { number, texts } from "../texts/texts.js";
import { button, choice, input, labelled, tick, Wrong } from "./fields.js";
import { address, mmPerUnit } from "./geometry.js";

const SHAPES = ["circle", "square", "diamond", "cross"];

// `onChange(fiducials)` is called with the list for the board type whenever it changes.
export function fiducialChoice(type, onChange) {
  const t = texts.setup;
  const marks = (type.fiducials ?? []).map((mark) => ({ mark, used: true }));
  const list = make("ul", { className: "ticks" });
  const report = () => onChange(marks.filter((m) => m.used).map((m) => m.mark));
  const draw = () => list.replaceChildren(...marks.map((entry) => {
    const { mark } = entry;
    const kind = mark.kind === "local" ? t.localFor((mark.components ?? []).join(", ")) : "";
    const line = tick("fiducial", t.fiducialAt(mark.name, number(mark.x, 3), number(mark.y, 3), number(mark.diameter, 3), type.unit ?? "mm", kind), entry.used);
    line.querySelector("input").addEventListener("change", (event) => {
      entry.used = event.target.checked;
      report();
    });
    return make("li", {}, line);
  }));
  draw();
  const parts = type.components ?? [];
  const options = make("datalist", { id: "fiducial-parts" }, ...parts.map((part) => make("option", { value: address(part) })));
  const ref = input("part", "", { maxLength: 80 });
  ref.setAttribute("list", options.id);
  const diameter = input("diameter", String(+(1 / mmPerUnit(type)).toPrecision(4)), { inputMode: "decimal" });
  const shape = choice("shape", Object.fromEntries(SHAPES.map((name) => [name, t.shapes[name]])), "circle");
  const said = make("p", { className: "answer" });
  said.setAttribute("role", "status");
  const add = button(t.addFiducial, async () => {
    const part = parts.find((p) => address(p) === ref.value.trim());
    const size = Number(diameter.value.replace(",", "."));
    if (!part) throw new Wrong(t.noSuchPart(ref.value));
    if (!(size > 0)) throw new Wrong(t.badDiameter(diameter.value));
    if (marks.some((m) => m.mark.name === address(part))) throw new Wrong(t.isFiducial(address(part)));
    marks.push({ mark: { name: address(part), x: part.center[0], y: part.center[1], shape: shape.value, diameter: size }, used: true });
    draw();
    report();
    ref.value = "";
    return "";
  }, said);
  return make("div", {}, marks.length ? "" : make("p", { className: "help", textContent: t.noFiducials }), list,
    make("details", {}, make("summary", { textContent: t.moreFiducials }),
      make("div", { className: "fields" }, labelled(t.part, ref), labelled(t.diameter, diameter, { unit: type.unit ?? "mm" }), labelled(t.shape, shape), options), add, said));
}
