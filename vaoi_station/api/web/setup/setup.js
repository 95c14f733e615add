// "Set up": the wizards of the engineer, one beside the other. Each is loaded when it is opened.
import { make, saidOf } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { texts } from "../texts/texts.js";
import { rightsFor } from "./rights.js";

// By the beginning of the address: the file that has the page, and the scope that it needs.
const PAGES = {
  types: ["./types.js", "teach"],
  "types/new": ["./preview.js", "teach"],
  "types/of": ["./type.js", "teach"],
  "types/lay": ["./overlay.js", "teach"],
  programs: ["./lights/programs.js", "teach"],
  calibration: ["./calibration.js", "admin"],
  optics: ["./optics/optics.js", "read"],
  settings: ["./settings/settings.js", "admin"],
  keys: ["./keys.js", "admin"],
};

export class SetupView {
  name = "setup-view";
  #page = null;
  #path;
  #query; // what a reload must find again

  constructor(path) {
    const [steps, query] = (path || "types").split("?");
    [this.#path, this.#query] = [steps.split("/").map(decodeURIComponent), new URLSearchParams(query)];
    this.root = make("div", { className: "setup" });
    const list = Object.entries(texts.setup.pages).map(([name, textContent]) => {
      const link = make("a", { href: `#/setup/${name}`, textContent });
      if (name === this.#path[0]) link.setAttribute("aria-current", "page");
      return make("li", {}, link);
    });
    const nav = make("nav", { className: "wizards", ariaLabel: texts.setup.title }, make("ul", {}, ...list));
    this.body = make("div", { className: "wizard" }, make("p", { className: "help", textContent: texts.loading }));
    this.root.append(nav, this.body);
  }

  async open() {
    const [first, second, third] = this.#path;
    const step = third && `${first}/${second}`;
    const [file, scope] = PAGES[step] ?? PAGES[first] ?? PAGES.types;
    try {
      if (!(await rightsFor(scope, this.body))) return;
      const { Page } = await import(file);
      if (!this.root.isConnected) return;
      const page = new Page(this.body, step in PAGES ? third : second, this.#query);
      await page.show();
      this.#page = page;
    } catch (error) {
      if (!(error instanceof rest.Refusal) && !(error instanceof TypeError)) throw error;
      this.body.replaceChildren(make("p", { className: "answer refused", role: "alert" }, ...saidOf(error)));
    }
  }

  close() {
    this.#page?.close?.();
  }

  onEvent(record) {
    this.#page?.onEvent?.(record);
  }
}
