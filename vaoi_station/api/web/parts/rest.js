// Calls to the station. A refusal carries the problem's detail and action.
// A proxy may offer the station under a path of its own, of which this file knows only its own address.
export const api = new URL("../../api/v1", import.meta.url).pathname;

export class Refusal extends Error {
  constructor(problem) {
    super(`${problem.detail} ${problem.action}`.trim());
    this.detail = problem.detail;
    this.status = problem.status;
    this.code = problem.code;
    this.errors = problem.errors ?? [];
  }
}

// Let a request end by itself: the page shows by other means that the station refuses or cannot be reached.
export const unattended = (promise) =>
  promise.catch((error) => {
    if (!(error instanceof Refusal) && !(error instanceof TypeError)) throw error;
  });

// A body that is a file is sent as it is, any other as JSON. `tag`: the ETag of the reply, for a later If-Match.
export async function request(method, path, body, headers = {}) {
  const file = body instanceof Blob;
  const answer = await fetch(api + path, {
    method,
    headers: { ...headers, ...(body ? { "Content-Type": file ? "application/octet-stream" : "application/json" } : {}) },
    body: body && !file ? JSON.stringify(body) : body,
  });
  const text = await answer.text();
  const json = /json/.test(answer.headers.get("Content-Type") ?? "");
  const content = !text ? null : json ? JSON.parse(text) : text;
  if (answer.status === 401 && path !== "/session") await beginAgain();
  if (!answer.ok) throw new Refusal(json && content ? content : { detail: `HTTP ${answer.status}.`, action: "", status: answer.status });
  return { content, tag: answer.headers.get("ETag") };
}

export const call = async (...order) => (await request(...order)).content;

// The login has ended, or its key was revoked: the page begins again, with the login.
async function beginAgain() {
  if (!(await session()).scopes.includes("read")) location.reload();
}

export const part = (address) => address.split("/").map(encodeURIComponent).join("/");

export const station = () => call("GET", "/station");
export const neighbours = () => call("GET", "/neighbours");
export const boardIsOut = (board) => call("DELETE", `/neighbours/boards/${part(board)}`);
export const boardTypes = async () => (await call("GET", "/board-types")).board_types;
export const runs = (query) => call("GET", `/runs?${new URLSearchParams(query)}`);
export const trends = (query) => call("GET", `/trends?${new URLSearchParams(query)}`);
export const trendComparison = (query) => call("GET", `/trends/comparison?${new URLSearchParams(query)}`);
export const calibration = () => call("GET", "/calibration");
export const cameraFrame = (camera) => call("GET", `/cameras/${camera}/frame`);
export const cameraPicture = ({ camera, run, row }, query = {}) => `${api}/cameras/${camera}/picture?${new URLSearchParams({ run, row, ...query })}`;
export const tryCamera = (camera, settings) => call("POST", `/cameras/${camera}/trial`, settings);
export const endTrial = (camera) => call("DELETE", `/cameras/${camera}/trial`);
export const trialPicture = (frame) => `${api}/cameras/${frame.camera}/trial/picture?number=${frame.number}`;
export const searchCameras = () => call("GET", "/cameras/search");
export const exchangeCamera = (camera, wanted) => call("POST", `/cameras/${camera}/exchange`, wanted);
export const confirmCamera = (camera) => call("POST", `/cameras/${camera}/exchange/confirm`);
export const examination = () => call("GET", "/doctor");
export const counts = () => call("GET", "/runs/counts");
export const decide = (id, decision) => call("PUT", `/runs/${encodeURIComponent(id)}/decision`, decision);
export const keptPicture = (found, width) => `${api}/runs/${encodeURIComponent(found.id)}/mosaics/kept.jpg?${new URLSearchParams({ width, _: found.started })}`;
export const mosaicList = (id) => call("GET", `/runs/${encodeURIComponent(id)}/mosaics`);
export const mosaics = async (id) => (await mosaicList(id)).mosaics;
export const run = (id) => call("GET", `/runs/${encodeURIComponent(id)}?figures=true`);
export const components = async (id, query = {}) =>
  (await call("GET", `/runs/${encodeURIComponent(id)}/components?${new URLSearchParams(query)}`)).components;
export const component = (id, ref, query = {}) =>
  call("GET", `/runs/${encodeURIComponent(id)}/components/${part(ref)}?${new URLSearchParams(query)}`);
export const matrices = (id) => call("GET", `/runs/${encodeURIComponent(id)}/matrices`);
export const timeline = (id) => call("GET", `/runs/${encodeURIComponent(id)}/timeline`);
export const overlay = (id) => call("GET", `/runs/${encodeURIComponent(id)}/overlay`);
export const heights = async (id) => (await call("GET", `/runs/${encodeURIComponent(id)}/heights`)).heights;
export const measures = (id) => call("GET", `/runs/${encodeURIComponent(id)}/parts`);
export const measuredPart = (id, ref) => call("GET", `/runs/${encodeURIComponent(id)}/parts/${part(ref)}`);
export const boardType = (name) => call("GET", `/board-types/${encodeURIComponent(name)}`);
export const limits = (type) => call("GET", `/board-types/${encodeURIComponent(type)}/limits`);
export const checkLimits = (type, wanted) => call("POST", `/board-types/${encodeURIComponent(type)}/limits/check`, wanted);
export const setLimits = (type, wanted) => call("PUT", `/board-types/${encodeURIComponent(type)}/limits`, wanted);
export const bothSides = (id, query = {}) => call("GET", `/boards/${encodeURIComponent(id)}?${new URLSearchParams(query)}`);
export const nextRun = (id) => call("GET", `/runs/next?${new URLSearchParams({ after: id, timeout: 0 })}`); // null: it is the last one
export const goodBoards = (type) => call("GET", `/board-types/${encodeURIComponent(type)}/good`);
export const keepAsGood = (id) => call("PUT", `/runs/${encodeURIComponent(id)}/good`);
export const removeFromGood = (id) => call("DELETE", `/runs/${encodeURIComponent(id)}/good`);
export const merged = async (id, query) => (await call("GET", `/runs/${encodeURIComponent(id)}/merged?${new URLSearchParams(query)}`)).pictures;
export const reference = (type) => call("GET", `/board-types/${encodeURIComponent(type)}/reference`);
export const runAddress = (id, rest) => `${api}/runs/${encodeURIComponent(id)}${rest}`;
export const arm = (request) => call("POST", "/station/arm", request);
export const disarm = () => call("POST", "/station/disarm");
export const acknowledge = (file) => call("POST", `/station/set-aside/${part(file)}/acknowledge`);
export const session = () => call("GET", "/session");
export const logIn = (key) => call("POST", "/session", { key });
export const logOut = () => call("DELETE", "/session");
export const eventsAddress = (after) => `${api}/events?after=${after}`;
