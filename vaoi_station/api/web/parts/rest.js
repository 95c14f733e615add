// Calls to the station. A refusal carries the problem's detail and action.
const api = "/api/v1";

export class Refusal extends Error {
  constructor(problem) {
    super(`${problem.detail} ${problem.action}`.trim());
    this.status = problem.status;
    this.code = problem.code;
  }
}

// Let a request end by itself: the page shows by other means that the station refuses or cannot be reached.
export const unattended = (promise) =>
  promise.catch((error) => {
    if (!(error instanceof Refusal) && !(error instanceof TypeError)) throw error;
  });

async function call(method, path, body) {
  const answer = await fetch(api + path, {
    method,
    headers: body ? { "Content-Type": "application/json" } : {},
    body: body ? JSON.stringify(body) : undefined,
  });
  const text = await answer.text();
  const content = text ? JSON.parse(text) : null;
  if (answer.status === 401 && path !== "/session") await beginAgain();
  if (!answer.ok) throw new Refusal(content ?? { detail: `HTTP ${answer.status}.`, action: "", status: answer.status });
  return content;
}

// The login has ended, or its key was revoked: the page begins again, with the login.
async function beginAgain() {
  if (!(await session()).scopes.includes("read")) location.reload();
}

const part = (address) => address.split("/").map(encodeURIComponent).join("/");

export const station = () => call("GET", "/station");
export const boardTypes = async () => (await call("GET", "/board-types")).board_types;
export const runs = (query) => call("GET", `/runs?${new URLSearchParams(query)}`);
export const counts = () => call("GET", "/runs/counts");
export const decide = (id, decision) => call("PUT", `/runs/${encodeURIComponent(id)}/decision`, decision);
export const mosaics = async (id) => (await call("GET", `/runs/${encodeURIComponent(id)}/mosaics`)).mosaics;
export const run = (id) => call("GET", `/runs/${encodeURIComponent(id)}`);
export const components = async (id, query = {}) =>
  (await call("GET", `/runs/${encodeURIComponent(id)}/components?${new URLSearchParams(query)}`)).components;
export const component = (id, ref, query = {}) =>
  call("GET", `/runs/${encodeURIComponent(id)}/components/${part(ref)}?${new URLSearchParams(query)}`);
export const arm = (request) => call("POST", "/station/arm", request);
export const disarm = () => call("POST", "/station/disarm");
export const acknowledge = (file) => call("POST", `/station/set-aside/${part(file)}/acknowledge`);
export const session = () => call("GET", "/session");
export const logIn = (key) => call("POST", "/session", { key });
export const logOut = () => call("DELETE", "/session");
export const eventsAddress = (after) => `${api}/events?after=${after}`;
