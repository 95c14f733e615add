// Live frames with their figures. A reply lists the latest frames; their pictures are loaded before anything is drawn, so
// that marks are always drawn on the frame in which they were detected.
import { histogram, node, sharpnessMap } from "/parts/camera_card.js";

const $ = (selector, root = document) => root.querySelector(selector);
const cards = new Map();
const best = new Map();
let held = false;
let number = 0;

$("#hold").addEventListener("click", (event) => {
  held = !held;
  event.target.setAttribute("aria-pressed", String(held));
  event.target.textContent = held ? "Continue" : "Hold";
});
$("#forget").addEventListener("click", () => best.clear());

function card(camera) {
  if (!cards.has(camera.camera)) {
    const made = $("#card").content.cloneNode(true).firstElementChild;
    const after = [...cards].filter(([n]) => n > camera.camera).map(([, c]) => c)[0] ?? null;
    $("#cameras").insertBefore(made, after);
    cards.set(camera.camera, made);
  }
  return cards.get(camera.camera);
}

function marks(camera) {
  const r = Math.max((camera.mark_size_px ?? 0) * 0.65, 0.012 * camera.width);
  const found = camera.marks.map((m) =>
    node("path", { class: "mark", d: `M${m.x - r} ${m.y}h${2 * r}M${m.x} ${m.y - r}v${2 * r}M${m.x - r} ${m.y - r}h${2 * r}v${2 * r}h${-2 * r}z` }));
  const doubtful = camera.doubtful.map((m) => {
    const mark = node("circle", { class: "doubtful", cx: m.x, cy: m.y, r });
    mark.append(node("title", {}, m.why));
    return mark;
  });
  return [...found, ...doubtful];
}

const percent = (share, digits = 0) => `${(100 * share).toFixed(digits)} %`;
const px = (value) => (value === null ? "–" : value.toFixed(2));

function focus(root, camera) {
  const f = camera.figures;
  const top = Math.max(best.get(camera.camera) ?? 0, f.focus);
  best.set(camera.camera, top);
  const share = top > 0 ? f.focus / top : 0;
  $(".now", root).value = share;
  const sharp = f.blur_px === null ? "no edges" : `blur ${px(f.blur_px)} px, MTF50 ${f.mtf50.toFixed(2)} cycles/px`;
  $(".words", root).textContent = `${percent(share)} of the best value (${f.focus.toPrecision(3)}); ${sharp}`;
  const tiles = f.blur_tiles_px.flatMap((blurs, row) => blurs.map((blur_px, column) => ({ column, row, blur_px })));
  $(".map", root).replaceChildren(...sharpnessMap(tiles, px));
  $(".levels", root).replaceChildren(histogram(camera.histogram, f.saturated, `${percent(f.saturated, 2)} of the pixels are saturated`));
}

function facts(root, camera) {
  const f = camera.figures;
  const entries = [
    ["mean", percent(f.mean)], ["saturated", percent(f.saturated, 2)],
    ["1 % below", percent(f.low)], ["99 % below", percent(f.high)],
    ["exposure", `${camera.exposure_us} µs`],
  ];
  if (camera.mark_size_px !== null) {
    const of = camera.marks_expected === null ? "" : ` of ${camera.marks_expected}`;
    entries.push(["marks", `${camera.marks.length}${of}`]);
  }
  $("dl", root).replaceChildren(...entries.flatMap(([name, value]) => [
    Object.assign(document.createElement("dt"), { textContent: name }),
    Object.assign(document.createElement("dd"), { textContent: value }),
  ]));
}

function list(element, sentences) {
  element.replaceChildren(...sentences.map((s) => Object.assign(document.createElement("li"), { textContent: s })));
}

function draw(camera, picture) {
  const root = card(camera);
  const heading = document.createElement("span");
  heading.textContent = `run ${camera.run}, row ${camera.row}`;
  $("h2", root).replaceChildren(`camera ${camera.camera}: ${camera.name}`, heading);
  picture.alt = `newest frame of camera ${camera.camera}`;
  $("img", root).replaceWith(picture);
  const overlay = $("svg.marks", root);
  overlay.setAttribute("viewBox", `-0.5 -0.5 ${camera.width} ${camera.height}`);
  overlay.replaceChildren(...marks(camera));
  focus(root, camera);
  facts(root, camera);
  list($(".remarks", root), camera.remarks);
  root.classList.toggle("warned", camera.remarks.length > 0);
  root.dataset.number = camera.number;
}

async function load(camera) {
  const picture = new Image();
  picture.src = `/api/cameras/${camera.camera}/picture?number=${camera.number}`;
  await picture.decode();
  return picture;
}

async function update() {
  const answer = await fetch(`/api/look?after=${number}&timeout_s=2`, { cache: "no-store" });
  if (!answer.ok) throw new Error(`HTTP status ${answer.status}`);
  const reply = await answer.json();
  $("#station").textContent = reply.station;
  list($("#notices"), reply.notices);
  const fresh = reply.cameras.filter((c) => cards.get(c.camera)?.dataset.number !== String(c.number));
  const loaded = await Promise.allSettled(fresh.map(load));
  if (held) return;
  fresh.forEach((camera, k) => loaded[k].status === "fulfilled" && draw(camera, loaded[k].value));
  number = reply.number;
  const silent = reply.names.length - reply.cameras.length;
  if (reply.cameras.length) $("#state").textContent = silent ? `${silent} cameras have not sent a frame yet.` : "";
}

const pause = (ms) => new Promise((done) => setTimeout(done, ms));

for (;;) {
  try {
    await update();
    await pause(held ? 400 : 80);
  } catch (error) {
    $("#state").textContent = `No reply (${error.message}): the frames shown are out of date. Check that vaoi view is running.`;
    await pause(1500);
  }
}
