// Calls to the station that only the pages under "Set up" make.
import { api, call, part, request } from "../parts/rest.js";

const types = "/board-types";
const previews = "/board-data/previews";
const stated = (options) => Object.fromEntries(Object.entries(options).filter(([, value]) => value !== "" && value != null));

export const typeList = () => call("GET", types);
export const boardType = (name) => request("GET", `${types}/${part(name)}`);
export const storeType = (document, condition = {}) => call("PUT", `${types}/${part(document.name)}`, document, condition);
export const ifNew = { "If-None-Match": "*" };
export const ifStill = (tag) => ({ "If-Match": tag });
// `program`: the steps to be checked; without any, those in force.
export const checkProgram = (name, program) => call("POST", `${types}/${part(name)}/program/check`, program ? { program } : {});
export const deleteType = (name) => call("DELETE", `${types}/${part(name)}`);
export const setState = (name, state, revision) => call("PUT", `${types}/${part(name)}/state`, stated({ state, revision }));
export const versions = async (name) => (await call("GET", `${types}/${part(name)}/revisions`)).revisions;
export const restore = (name, version) => call("POST", `${types}/${part(name)}/revisions/${part(version)}/restore`);
export const reference = (name) => call("GET", `${types}/${part(name)}/reference`);
export const teach = (name, run) => call("PUT", `${types}/${part(name)}/reference`, { run });
export const forget = (name) => call("DELETE", `${types}/${part(name)}/reference`);
export const check = (run, name) => call("GET", `/runs/${part(run)}/board-check?${new URLSearchParams({ board_type: name })}`);
export const checkPicture = (run, name) => `${api}/runs/${part(run)}/board-check/picture?${new URLSearchParams({ board_type: name })}`;
export const correct = (name, run) => call("POST", `${types}/${part(name)}/correct`, { run });

export const previewList = async () => (await call("GET", previews)).previews;
export const preview = (id) => call("GET", `${previews}/${part(id)}`);
export const upload = (file, options) => call("POST", `${previews}?${new URLSearchParams({ filename: file.name, ...stated(options) })}`, file);
export const change = (id, options) => call("PUT", `${previews}/${part(id)}`, stated(options));
export const discard = (id) => call("DELETE", `${previews}/${part(id)}`);
export const previewed = (id) => call("GET", `${previews}/${part(id)}/board-type`);

const numbers = (options) => new URLSearchParams(stated(options));
export const artwork = (file, options) => `${api}/calibration/artwork/${file}?${numbers(options)}`;
export const layout = (options) => call("GET", `/calibration/layout?${numbers(options)}`);
export const findMarks = (wanted) => call("POST", "/calibration/marks", stated(wanted));
export const trial = () => call("GET", "/calibration/trial");
export const beginTrial = (wanted) => call("POST", "/calibration/trial", stated(wanted));
export const discardTrial = () => call("DELETE", "/calibration/trial");
export const acceptTrial = () => call("POST", "/calibration/trial/accept");
export const trialCalibration = `${api}/calibration/trial/calibration`;
export const trialPicture = (name, begun) => `${api}/calibration/trial/pictures/${name}?_=${encodeURIComponent(begun)}`;
export const frame = (run, camera, row) => `${api}/runs/${part(run)}/frames/${camera}/${row}?format=png&incomplete=show`;

export const opticsRequirements = (of) => call("GET", `/optics/requirements?of=${of}`);
export const opticsPlan = (values) => call("GET", `/optics/plan?${new URLSearchParams(values)}`);

export const settings = () => request("GET", "/settings");
export const checkSettings = (changes) => call("POST", "/settings/check", { changes });
export const saveSettings = (changes, tag) => call("PUT", "/settings", { changes }, ifStill(tag));

export const keys = async () => (await call("GET", "/keys")).keys;
export const createKey = (name, scopes) => call("POST", "/keys", { name, scopes });
export const rotateKey = (name) => call("POST", `/keys/${part(name)}/rotate`);
export const revokeKey = (name) => call("DELETE", `/keys/${part(name)}`);
