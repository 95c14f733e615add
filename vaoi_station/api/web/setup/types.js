// Board types: those of the station, files that were uploaded and not confirmed yet, and the place where a file is dropped.
import { make } from "../parts/elements.js";
import { texts } from "../texts/texts.js";
import { attempt, button, choice, labelled, section, SetupPage, table } from "./fields.js";
import * as requests from "./requests.js";

export const typeAddress = (name, step = "of") => `#/setup/types/${step}/${encodeURIComponent(name)}`;

export class Page extends SetupPage {
  #side = choice("side", texts.setup.sides, "top");
  #list = make("div");

  constructor(...page) {
    super(...page);
    const file = make("input", { type: "file", id: "board-file", className: "file" });
    file.addEventListener("change", () => this.#upload(file.files[0]));
    const pick = make("label", { htmlFor: file.id, className: "drop", id: "drop" }, make("strong", { textContent: texts.setup.drop }), make("span", { textContent: texts.setup.dropFormats }));
    pick.addEventListener("dragover", (event) => {
      event.preventDefault();
      pick.classList.add("over");
    });
    pick.addEventListener("dragleave", () => pick.classList.remove("over"));
    pick.addEventListener("drop", (event) => {
      event.preventDefault();
      pick.classList.remove("over");
      this.#upload(event.dataTransfer.files[0]);
    });
    this.root.replaceChildren(
      make("h2", { textContent: texts.setup.pages.types }),
      section(texts.setup.newType, make("div", { className: "row" }, make("div", { className: "drop-field" }, file, pick), labelled(texts.setup.sideUp, this.#side)), this.answer),
      this.#list);
  }

  async #upload(file) {
    if (!file) return;
    await attempt(this.root.querySelector("#board-file"), async () => {
      const preview = await requests.upload(file, { side: this.#side.value });
      location.hash = `#/setup/types/new/${preview.id}`;
    }, this.answer);
  }

  async show() {
    const [{ board_types: types, deleted }, previews] = await Promise.all([requests.typeList(), requests.previewList()]);
    const columns = texts.setup.typeColumns;
    const rows = types.map((type) => [
      make("a", { href: typeAddress(type.name), textContent: type.name }), type.revision ?? "",
      make("span", { className: `state ${type.state}`, ...(type.fault ? { lang: "en" } : {}), textContent: type.fault ? type.fault.message : texts.setup.states[type.state] ?? type.state }),
      texts.setup.sides[type.side] ?? type.side, String(type.components), String(type.fiducials),
    ]);
    const known = types.length ? table(columns, rows) : make("p", { textContent: texts.setup.noTypes });
    const pending = previews.length ? section(texts.setup.pending, make("ul", { className: "links" }, ...previews.map((p) =>
      make("li", {}, make("a", { href: `#/setup/types/new/${p.id}`, textContent: texts.setup.pendingFile(p.filename, p.found?.components) }))))) : "";
    const back = deleted?.length ? section(texts.setup.deleted, make("ul", { className: "links" }, ...deleted.map((name) =>
      make("li", {}, make("span", { textContent: name }), button(texts.setup.restore, async () => {
        await requests.restore(name, "latest");
        await this.show();
      }, this.answer))))) : "";
    this.#list.replaceChildren(section(texts.setup.known, known), pending, back);
  }
}
