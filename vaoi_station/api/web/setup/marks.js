// The marks of a board type: fiducials that place it, marks of a panel, and bad-board marks. The data name them, or a person names a part.
import { make } from "../parts/elements.js";
import { entered, number, texts } from "../texts/texts.js";
import { answerLine, button, choice, input, labelled, tick, Wrong } from "./fields.js";
import { address, mmPerUnit } from "./geometry.js";

const SHAPES = ["circle", "square", "diamond", "cross"];
const LOOKS = ["", "dark", "light"]; // how a bad-board mark looks on a bad board; "": the mark is not read

const looks = () => Object.fromEntries(LOOKS.map((look) => [look, texts.setup.looks[look]]));

// `onChange({ fiducials, other_marks })` is called with both lists for the board type whenever one changes.
export function markChoice(type, onChange) {
  const t = texts.setup;
  const marks = [...(type.fiducials ?? []).map((mark) => ({ mark, used: true, places: true })), ...(type.other_marks ?? []).map((mark) => ({ mark, used: true, places: false }))];
  const list = make("ul", { className: "ticks" });
  const used = (places) => marks.filter((m) => m.used && m.places === places).map((m) => m.mark);
  const report = () => onChange({ fiducials: used(true), other_marks: used(false).length ? used(false) : undefined });
  const draw = () => list.replaceChildren(...marks.map((entry) => markLine(entry, type.unit ?? "mm", report)));
  draw();
  const none = used(true).length ? "" : make("p", { className: "help", textContent: t.noFiducials });
  const add = (mark, places) => {
    if (marks.some((m) => m.mark.name === mark.name)) throw new Wrong(t.isMark(mark.name));
    marks.push({ mark, used: true, places });
    draw();
    report();
  };
  return make("div", {}, none, list, make("details", {}, make("summary", { textContent: t.moreMarks }), namedPart(type, add)));
}

// One mark with its tick; a bad-board mark with its look on a bad board as well.
function markLine(entry, unit, report) {
  const t = texts.setup;
  const { mark } = entry;
  const kinds = { local: () => t.localFor((mark.components ?? []).join(", ")), panel: () => t.ofPanel, "bad-board": () => t.badBoardOf(mark.panel ?? "?") };
  const line = tick(entry.places ? "fiducial" : "mark", t.markAt(mark.name, number(mark.x, 3), number(mark.y, 3), number(mark.diameter, 3), unit, kinds[mark.kind]?.() ?? ""), entry.used);
  line.querySelector("input").addEventListener("change", (event) => {
    entry.used = event.target.checked;
    report();
  });
  if (mark.kind !== "bad-board" || mark.panel == null) return make("li", {}, line);
  const look = choice("look", looks(), mark.bad ?? "");
  look.addEventListener("change", () => {
    const { bad, good, ...rest } = mark;
    entry.mark = look.value ? { ...rest, bad: look.value } : rest;
    report();
  });
  return make("li", {}, line, labelled(t.look, look));
}

// The form by which a person names a part as a mark: `add(mark, places)`.
function namedPart(type, add) {
  const t = texts.setup;
  const parts = type.components ?? [];
  const options = make("datalist", { id: "mark-parts" }, ...parts.map((part) => make("option", { value: address(part) })));
  const ref = input("part", "", { maxLength: 80 });
  ref.setAttribute("list", options.id);
  const diameter = input("diameter", entered(+(1 / mmPerUnit(type)).toPrecision(4)), { inputMode: "decimal" });
  const shape = choice("shape", Object.fromEntries(SHAPES.map((name) => [name, t.shapes[name]])), "circle");
  const boards = [...new Set(parts.map((part) => part.panel).filter((panel) => panel != null))];
  const kind = choice("kind", { fiducial: t.kinds.fiducial, "bad-board": t.kinds.badBoard }, "fiducial");
  const board = choice("board", boards.map(String), String(boards[0] ?? ""));
  const look = choice("bad-look", looks(), "dark");
  const ofBoard = [labelled(t.ofBoard, board), labelled(t.look, look)];
  const show = () => ofBoard.forEach((field) => (field.hidden = kind.value === "fiducial"));
  kind.addEventListener("change", show);
  show();
  const said = answerLine();
  const press = button(t.addMark, async () => {
    const part = parts.find((p) => address(p) === ref.value.trim());
    const size = Number(diameter.value.replace(",", "."));
    if (!part) throw new Wrong(t.noSuchPart(ref.value));
    if (!(size > 0)) throw new Wrong(t.badDiameter(diameter.value));
    const mark = { name: address(part), x: part.center[0], y: part.center[1], shape: shape.value, diameter: size };
    const bad = look.value ? { bad: look.value } : {};
    if (kind.value === "fiducial") add(mark, true);
    else add({ ...mark, kind: "bad-board", panel: boards.find((panel) => String(panel) === board.value), ...bad }, false);
    ref.value = "";
    return "";
  }, said);
  // Bad-board marks are about boards of a panel.
  const kindFields = boards.length ? [labelled(t.kind, kind), ...ofBoard] : [];
  return make("div", {}, make("div", { className: "fields" }, labelled(t.part, ref), labelled(t.diameter, diameter, { unit: type.unit ?? "mm" }), labelled(t.shape, shape), ...kindFields, options), press, said);
}
