// A page that changes the station needs a scope. Without it, a key is asked for.
import { make } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { texts } from "../texts/texts.js";
import { answerLine, attempt, input, labelled, Wrong } from "./fields.js";

// Resolves to whether the caller has the scope; if not, `root` shows a form for a key, after which the page begins anew.
export async function rightsFor(scope, root) {
  let scopes;
  try {
    ({ scopes } = await rest.session());
  } catch (error) {
    if (error.status === 404) return true; // a station without keys
    throw error;
  }
  if (scopes.includes(scope)) return true;
  const key = input("key", "", { type: "password", required: true, maxLength: 200, autocomplete: "current-password" });
  const answer = answerLine();
  const enter = make("button", { textContent: texts.logIn });
  const form = make("form", { className: "panel rights" }, make("h2", { textContent: texts.setup.needsScope(scope) }),
    make("p", { textContent: texts.setup.needsScopeHelp(scope) }), labelled(texts.key, key), enter, answer);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    attempt(enter, async () => {
      const state = await rest.logIn(key.value);
      if (!state.scopes.includes(scope)) throw new Wrong(texts.setup.keyLacks(state.key, scope));
      location.reload();
      return "";
    }, answer);
  });
  root.replaceChildren(form);
  key.focus();
  return false;
}
