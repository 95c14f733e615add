// Keys of callers from other machines: make, list, replace, revoke. A secret is shown once.
import { make } from "../parts/elements.js";
import { moment, texts } from "../texts/texts.js";
import { attempt, button, copyOf, input, labelled, section, SetupPage, table, tick, Wrong } from "./fields.js";
import * as requests from "./requests.js";

const SCOPES = ["read", "operate", "teach", "admin"];

export class Page extends SetupPage {
  #secret = make("div");
  #list = make("div");

  constructor(...page) {
    super(...page);
    const t = texts.setup;
    const name = input("name", "", { required: true, maxLength: 64, pattern: "[A-Za-z0-9][A-Za-z0-9._\\-]*" });
    const scopes = SCOPES.map((scope) => tick(scope, `${scope}: ${t.scopeMeans[scope]}`, scope === "read"));
    const enter = make("button", { textContent: t.makeKey, className: "primary" });
    const form = make("form", { id: "new-key" }, labelled(t.keyName, name, { help: t.keyNameHelp }), make("fieldset", {}, make("legend", { textContent: t.scopes }), ...scopes), enter);
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      const wanted = SCOPES.filter((scope) => form.elements[scope].checked);
      attempt(enter, async () => {
        if (!wanted.length) throw new Wrong(t.noScope);
        await this.#show(await requests.createKey(name.value, wanted));
        name.value = "";
        return "";
      }, this.answer);
    });
    this.root.replaceChildren(make("h2", { textContent: t.pages.keys }), this.answer, this.#secret, make("div", { className: "two" }, this.#list, section(t.newKey, form)));
  }

  async #show(made) {
    const t = texts.setup;
    const field = input("secret", made.secret, { readOnly: true, id: "secret" });
    const copy = button(t.copy, async () => {
      await copyOf(field);
      return t.selected;
    }, this.answer);
    const done = button(t.hideSecret, async () => this.#secret.replaceChildren() ?? "", this.answer, { className: "plain" });
    this.#secret.replaceChildren(section(t.secretOf(made.name), make("p", { className: "help", textContent: t.secretHelp }), field, make("div", { className: "buttons" }, copy, done)));
    field.select();
    await this.show();
  }

  async show() {
    const t = texts.setup;
    const keys = await requests.keys();
    const rows = keys.map((key) => [key.name, key.scopes.join(", "), moment(key.created), this.#orders(key)]);
    this.#list.replaceChildren(section(t.knownKeys, keys.length ? table(t.keyColumns, rows) : make("p", { textContent: t.noKeys })));
  }

  // A key is revoked by a second press: programs that use it fail at once.
  #orders(key) {
    const t = texts.setup;
    const replace = button(t.rotate, async () => {
      await this.#show(await requests.rotateKey(key.name));
      return "";
    }, this.answer);
    const revoke = button(t.revoke, async () => {
      if (!revoke.classList.contains("sure")) {
        revoke.classList.add("sure");
        revoke.textContent = t.revokeSure(key.name);
        return "";
      }
      await requests.revokeKey(key.name);
      await this.show();
      return t.revoked(key.name);
    }, this.answer, { className: "plain" });
    return make("div", { className: "buttons" }, replace, revoke);
  }
}
