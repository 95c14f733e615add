// Log the page in with a key, once. The station keeps the login as a cookie that scripts cannot read.
import * as rest from "./rest.js";
import { texts } from "./texts.en.js";

const $ = (id) => document.getElementById(id);

// Resolves when the caller may read, if necessary after a login.
export async function loggedIn() {
  let state;
  try {
    state = await rest.session();
  } catch {
    return; // a station without keys, or one that cannot be reached: the page shows that by other means
  }
  $("log-out").hidden = !state.key;
  $("log-out").addEventListener("click", async () => {
    await rest.logOut();
    location.reload();
  });
  if (state.scopes.includes("read")) return;
  $("login").hidden = false;
  $("key").focus();
  await new Promise((done) => {
    $("login").addEventListener("submit", async (event) => {
      event.preventDefault();
      try {
        await rest.logIn($("key").value);
        $("key").value = "";
        $("login").hidden = true;
        $("log-out").hidden = false;
        done();
      } catch (error) {
        $("login-answer").textContent = error instanceof rest.Refusal ? error.message : texts.noAnswer;
      }
    });
  });
}
