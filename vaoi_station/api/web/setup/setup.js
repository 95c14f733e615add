// "Set up": the wizards of the engineer, one beside the other. Each is loaded when it is opened.
import { make, saidOf } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { fillIn, texts } from "../texts/texts.js";
import { rightsFor } from "./rights.js";

// Name in the address, the file that has the page, the scope that it needs.
const PAGES = {
  types: ["./types.js", "teach"],
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
    const list = Object.keys(PAGES).map((name) => {
      const link = make("a", { href: `#/setup/${name}`, textContent: texts.setup.pages[name] });
      if (name === this.#path[0]) link.setAttribute("aria-current", "page");
      return make("li", {}, link);
    });
    const nav = make("nav", { className: "wizards" }, make("ul", {}, ...list));
    nav.setAttribute("aria-label", texts.setup.title);
    this.body = make("div", { className: "wizard" }, make("p", { className: "help", textContent: texts.loading }));
    this.root.append(nav, this.body);
  }

  async open() {
    const [file, scope] = PAGES[this.#path[0]] ?? PAGES.types;
    try {
      if (!(await rightsFor(scope, this.body))) return;
      const { open } = await import(file);
      if (!this.root.isConnected) return;
      this.#page = await open(this.body, this.#path.slice(1), this.#query);
      fillIn(this.body);
    } catch (error) {
      if (!(error instanceof rest.Refusal) && !(error instanceof TypeError)) throw error;
      const answer = make("p", { className: "answer refused" });
      answer.setAttribute("role", "alert");
      this.body.replaceChildren(answer);
      answer.replaceChildren(...saidOf(error));
    }
  }

  close() {
    this.#page?.close?.();
  }

  onEvent(record) {
    this.#page?.onEvent?.(record);
  }

  async show() {}
}
