// Both sides of a board as one: verdict, reasons, picture and map of the parts of each, and where a part is.
import { boardPicture } from "../parts/board_picture.js";
import { make, said, saidOf, setText, View } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { draw, sign } from "../parts/signs.js";
import { svg } from "../parts/svg.js";
import { moment, texts } from "../texts/texts.js";
import { reasonSaid, sentence } from "./report.js";
import { pageOf } from "./side_links.js";

const SIDES = ["top", "bottom"];
const PART = `
<section id="sides-head">
  <svg id="sides-shape" viewBox="0 0 100 100" aria-hidden="true"></svg>
  <h2 id="sides-title" data-text="board.loading"></h2>
  <p id="sides-flip"></p>
  <form id="sides-find"><label><span data-text="board.sides.find"></span><input id="sides-part" spellcheck="false" autocomplete="off"></label><button data-text="show"></button></form>
  <a href="#/boards" class="button" data-text="back"></a>
  <p id="sides-answer" role="status"></p>
</section>
<ul id="sides-reasons"></ul>
<section id="side-top" class="board-side" tabindex="-1" data-label="board.sides.names.top"></section>
<section id="side-bottom" class="board-side" tabindex="-1" data-label="board.sides.names.bottom"></section>`;

const verdictOf = (side) => side.verdict ?? "failed";

export class SidesView extends View {
  name = "sides-view";
  #id;
  #board = null;
  #seen = "";
  #closed = new AbortController();

  constructor(_station, id) {
    super(PART, make("div", { className: "sides" }));
    try {
      this.#id = decodeURIComponent(id);
    } catch {
      this.#id = id; // there is no such board
    }
    this.part("sides-find").addEventListener("submit", (event) => {
      event.preventDefault();
      this.#find(this.part("sides-part").value.trim());
    });
    document.addEventListener("keydown", (event) => this.#key(event), this.#closed);
  }

  // Alt+S goes to the other side, as on the page of one.
  #key(event) {
    if (!event.altKey || event.code !== "KeyS") return;
    event.preventDefault();
    this.part(this.part("side-top").contains(document.activeElement) ? "side-bottom" : "side-top").focus();
  }

  close() {
    this.#closed.abort();
  }

  // Asked again with each event, without the parts; drawn only if something has changed.
  async show() {
    let board;
    try {
      board = await rest.bothSides(this.#id);
      if (this.#seen === JSON.stringify(board)) return;
      board = await rest.bothSides(this.#id, { parts: true });
      // Of what is drawn: a refusal, or what has changed meanwhile, is asked for again.
      this.#seen = JSON.stringify(board, (key, value) => (key === "parts" ? undefined : value));
    } catch (error) {
      if (!(error instanceof rest.Refusal)) throw error;
      draw(this.part("sides-shape"), "unknown");
      this.part("sides-title").replaceChildren(...(error.status === 404 ? [texts.notFound] : saidOf(error)));
      return;
    }
    this.#board = board;
    const words = texts.board.sides;
    draw(this.part("sides-shape"), board.status);
    this.part("sides-head").dataset.verdict = board.status;
    setText(this.part("sides-title"), `${board.board_id}: ${texts.verdicts[board.status]}`);
    setText(this.part("sides-flip"), board.flip ? words.flip(board.flip, board.flip_by.map((by) => words.by[by])) : "");
    const reasons = board.reasons.map(({ code, message, action }) => said(`${sentence(message)} ${sentence(action)}`, texts.boardSides[code]));
    this.part("sides-reasons").replaceChildren(...reasons.map((reason) => make("li", {}, ...reason)));
    for (const name of SIDES) this.#showSide(name, board[name]);
  }

  #showSide(name, side) {
    const words = texts.board.sides;
    const root = this.part(`side-${name}`);
    if (!side) {
      root.replaceChildren(make("h3", { textContent: words.names[name] }), make("p", { textContent: this.#board.coming.includes(name) ? words.coming : words.missing }));
      return;
    }
    const { parts } = side;
    const title = make("a", { href: pageOf(side), textContent: `${words.names[name]}: ${texts.verdicts[verdictOf(side)]}` });
    const facts = [moment(side.started), [side.board_type, side.revision].filter(Boolean).join(" "), words.parts(parts.address.length, parts.unseen.length), side.station].filter(Boolean);
    const picture = make("div", { className: "side-picture" });
    const head = make("h3", {}, sign(verdictOf(side)), title);
    head.dataset.verdict = verdictOf(side);
    root.replaceChildren(
      head,
      make("p", { className: "side-facts", textContent: facts.join(", ") }),
      ...(side.reasons.length ? [make("ul", {}, ...side.reasons.map((reason) => make("li", {}, ...reasonSaid(reason))))] : []),
      make("div", { className: "side-views" }, picture, this.#map(side)),
    );
    rest.unattended(this.#picture(picture, side));
  }

  async #picture(root, side) {
    const words = texts.board.sides;
    const elsewhere = side.address.includes("://"); // the page may load pictures of its own station only
    const shown = elsewhere ? null : await boardPicture(await rest.run(side.run), { steps: 2, alt: words.picture(words.names[side.side]) }).catch(() => null);
    root.replaceChildren(shown ?? (elsewhere ? make("a", { href: pageOf(side), textContent: words.elsewhere }) : make("p", { textContent: words.noPicture })));
  }

  // The parts as the cameras see them: the bottom from below, its x to the left.
  #map(side) {
    const { parts } = side;
    const across = side.side === "bottom" ? -1 : 1;
    const shown = ([x, y]) => [across * x, -y];
    const corners = parts.address.map((_, n) => {
      const turn = (parts.rotation_deg[n] * Math.PI) / 180;
      const [cos, sin, w, h] = [Math.cos(turn), Math.sin(turn), parts.width_mm[n] / 2, parts.height_mm[n] / 2];
      return [[-w, -h], [w, -h], [w, h], [-w, h]].map(([u, v]) => shown([parts.x_mm[n] + cos * u - sin * v, parts.y_mm[n] + sin * u + cos * v]));
    });
    const outline = (parts.outline_mm ?? []).map(shown);
    // Two points are opposite corners of a rectangle.
    const edge = outline.length === 2 ? [outline[0], [outline[1][0], outline[0][1]], outline[1], [outline[0][0], outline[1][1]]] : outline;
    const every = [...edge, ...corners.flat()];
    const bounds = [0, 1].map((axis) => every.reduce(([low, high], point) => [Math.min(low, point[axis]), Math.max(high, point[axis])], [Infinity, -Infinity]));
    const [[x0, x1], [y0, y1]] = every.length ? bounds : [[0, 1], [0, 1]];
    const margin = 0.02 * Math.max(x1 - x0, y1 - y0);
    const path = (polygons) => polygons.map((points) => `M${points.map((point) => point.map((v) => v.toFixed(3)).join(" ")).join("L")}Z`).join("");
    const unseen = new Set(parts.unseen);
    const those = (wanted) => corners.filter((_, n) => unseen.has(parts.address[n]) === wanted);
    const map = svg("svg", {
      class: "side-map", role: "img", viewBox: `${x0 - margin} ${y0 - margin} ${x1 - x0 + 2 * margin} ${y1 - y0 + 2 * margin}`,
      "aria-label": texts.board.sides.map(texts.board.sides.names[side.side], parts.address.length),
    }, svg("path", { class: "edge", d: edge.length ? path([edge]) : "" }), svg("path", { class: "seen", d: path(those(false)) }), svg("path", { class: "unseen", d: path(those(true)) }));
    map.addEventListener("click", (event) => {
      const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(map.getScreenCTM().inverse());
      const hit = parts.address.map((address, n) => ({ address, corners: corners[n], size: parts.width_mm[n] * parts.height_mm[n] })).filter((one) => contains(one.corners, at));
      if (hit.length) location.href = pageOf(side, hit.sort((a, b) => a.size - b.size)[0].address);
    });
    return map;
  }

  // A part is on one side: its address leads there.
  #find(wanted) {
    for (const side of SIDES.map((name) => this.#board?.[name]).filter(Boolean)) {
      const address = side.parts.address.find((one) => one.toLowerCase() === wanted.toLowerCase());
      if (!address) continue;
      location.href = pageOf(side, address);
      return;
    }
    setText(this.part("sides-answer"), wanted ? texts.board.noPart(wanted) : "");
  }
}

// Whether a point is within a rectangle that may be turned.
function contains(corners, { x, y }) {
  const sides = corners.map(([x0, y0], n) => {
    const [x1, y1] = corners[(n + 1) % corners.length];
    return (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0);
  });
  return sides.every((side) => side >= 0) || sides.every((side) => side <= 0);
}
