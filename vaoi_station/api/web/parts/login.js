// Log the page in with a key, once. The station keeps the login as a cookie that scripts cannot read.
import { session } from "../ahead.js";
import * as rest from "./rest.js";
import { make, saidOf } from "./elements.js";
import { texts } from "../texts/texts.js";

// The elements are made only where they are needed: a page on the station's own machine has no login.
function offerLogOut() {
  const link = make("a", { href: "#", id: "log-out", textContent: texts.logOut });
  link.addEventListener("click", async (event) => {
    event.preventDefault();
    await rest.logOut().catch(() => {}); // the login may have ended already
    location.reload();
  });
  document.querySelector("nav").append(" ", link);
}

// Resolves when the caller may read, if necessary after a login.
export async function loggedIn(live) {
  let state;
  try {
    state = await session;
  } catch {
    return; // a station without keys, or one that cannot be reached: the page shows that by other means
  }
  if (state.scopes.includes("read")) {
    if (state.key) offerLogOut();
    return;
  }
  const key = make("input", { id: "key", type: "password", required: true, maxLength: 200, autocomplete: "current-password" });
  const answer = make("p", { id: "login-answer", role: "alert" });
  const form = make("form", { id: "login" }, make("h2", { textContent: texts.logInTitle }),
    make("label", { htmlFor: "key", textContent: texts.key }), key, make("button", { textContent: texts.logIn }), answer,
    make("p", { textContent: texts.logInHelp }));
  const place = make("div", { role: "main" }, form); // the other one is hidden
  const main = document.querySelector("main");
  live.pause();
  main.hidden = true;
  main.before(place);
  key.focus();
  await new Promise((done) => {
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      try {
        await rest.logIn(key.value);
        place.remove();
        main.hidden = false;
        live.resume();
        offerLogOut();
        done();
      } catch (error) {
        answer.replaceChildren(...(error.code === "no-key" ? [texts.wrongKey] : saidOf(error)));
        key.select();
      }
    });
  });
}
