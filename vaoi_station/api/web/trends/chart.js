// One figure over time: a line per part, its limits, and where something changed. A point opens its board. All figures have one time
// axis and one cursor.
import { loadScript, make, setText } from "../parts/elements.js";
import { moment, number, texts, tick } from "../texts/texts.js";

const LIBRARY = new URL("../vendor/uplot/uPlot", import.meta.url).href;
document.head.append(make("link", { rel: "stylesheet", href: `${LIBRARY}.min.css` }));
const HEIGHT = 110;
const AXIS_HEIGHT = 46;
const LEFT_PX = 62; // of the axis of values: the charts lie one below the other
const FONT = "13px system-ui, 'DejaVu Sans', sans-serif";
const COLOURS = 6; // --series-1 … of the style sheet
const DASHES = [[], [8, 4], [2, 3], [10, 3, 2, 3]]; // lines differ without colour too, from the seventh on
const BANDS = 3; // with more parts, the bands of least and largest values would hide the lines
const NEAR_PX = 30;

const digits = (figure, value) => number(value, figure.endsWith("_px") ? 3 : figure === "slip_percent" ? 2 : figure === "ready_ms" ? 0 : 1);
const beyond = (series, value) => value != null && ((series.upper != null && value > series.upper) || (series.lower != null && value < series.lower));

const seconds = (time) => Date.parse(time) / 1000;
const cursor = { sync: { key: "trends", setSeries: false }, drag: { x: false, y: false }, y: false };

// The span, without the time before the first board.
function spanOf(trends) {
  const [since, until, first] = [trends.since, trends.until, trends.times[0]].map(seconds);
  return [Math.max(since, first - 0.02 * (until - first)), until];
}

function axisOf(style) {
  const edge = style.getPropertyValue("--edge");
  return { stroke: style.getPropertyValue("--soft"), font: FONT, grid: { stroke: edge, width: 1 }, ticks: { stroke: edge, width: 1, size: 4 } };
}

// The places, px of the canvas, at which something changed.
const marksOf = (plot, trends) => trends.marks.map((mark) => [mark, plot.valToPos(seconds(mark.time), "x", true)]);

// The time axis of all charts, with the names of what changed. It stays in sight while they scroll.
export class TimeAxis {
  #plot = null;
  #resized = new ResizeObserver(() => this.#plot?.setSize({ width: this.root.clientWidth, height: AXIS_HEIGHT }));

  constructor() {
    this.root = make("div", { className: "time-axis", ariaHidden: "true" });
    this.#resized.observe(this.root);
  }

  async show(trends) {
    await loadScript(`${LIBRARY}.iife.min.js`);
    if (!this.root.isConnected) return;
    this.#plot?.destroy();
    this.#plot = null;
    if (!trends.boards) return;
    const axis = axisOf(getComputedStyle(this.root));
    this.#plot = new window.uPlot({
      width: this.root.clientWidth, height: AXIS_HEIGHT, legend: { show: false }, cursor: { ...cursor, points: { show: false } }, padding: [0, null, 0, LEFT_PX],
      scales: { x: { time: true, range: () => spanOf(trends) } },
      axes: [{ ...axis, size: 26, values: (_, splits, __, ___, step) => splits.map((time) => tick(time * 1000, step)), space: 70 }],
      series: [{}],
      hooks: { draw: [(plot) => this.#name(plot, trends)] },
    }, [trends.times.map(seconds)], this.root);
  }

  // A name that would lie over the one before is left out: the list of what changed has it.
  #name(plot, trends) {
    const { ctx } = plot;
    const scale = devicePixelRatio;
    ctx.save();
    ctx.font = FONT.replace("13px", `${13 * scale}px`);
    ctx.fillStyle = getComputedStyle(this.root).getPropertyValue("--ink");
    ctx.textAlign = "left";
    ctx.textBaseline = "top";
    let free = 0;
    for (const [mark, x] of marksOf(plot, trends)) {
      const name = texts.trends.kinds[mark.kind];
      ctx.fillRect(x, 0, scale, AXIS_HEIGHT * scale);
      if (x < free) continue;
      ctx.fillText(name, x + 4 * scale, 0);
      free = x + ctx.measureText(name).width + 12 * scale;
    }
    ctx.restore();
  }

  close() {
    this.#resized.disconnect();
    this.#plot?.destroy();
  }
}

export class Chart {
  #figure;
  #plot = null;
  #trends = null;
  #series = [];
  #at = null;
  #style = null;
  #resized = new ResizeObserver(() => this.#fit());

  constructor(figure) {
    this.#figure = figure;
    this.root = make("section", { className: "chart", id: `chart-${figure}` });
    this.title = make("h3", { textContent: `${texts.trends.figures[figure]}` }, make("small", { textContent: ` ${texts.trends.units[figure]}` }));
    this.parts = make("ul", { className: "chart-parts" });
    this.warning = make("p", { className: "chart-warning" });
    this.area = make("div", { className: "chart-area", tabIndex: 0, role: "slider", ariaLabel: texts.trends.figures[figure] });
    this.readout = make("p", { className: "chart-readout" });
    this.root.append(make("div", { className: "chart-head" }, this.title, this.warning, this.parts, this.readout), this.area);
    this.area.addEventListener("keydown", (event) => this.#key(event));
    this.area.addEventListener("click", () => this.#open(this.#near(this.#plot.cursor.top)));
    this.#resized.observe(this.area);
  }

  async show(trends, series) {
    [this.#trends, this.#series] = [trends, series];
    this.#at = null;
    await loadScript(`${LIBRARY}.iife.min.js`);
    const { uPlot } = window;
    if (!this.root.isConnected) return;
    this.#style = getComputedStyle(this.root);
    const times = trends.times.map(seconds);
    const banded = series.length <= BANDS && trends.bin_s != null;
    const columns = series.flatMap((s) => (banded ? [s.values, s.least, s.largest] : [s.values]));
    this.#plot?.destroy();
    this.#plot = new uPlot(this.#options(uPlot, banded), [times, ...columns], this.area);
    this.#showParts();
    this.#describe();
  }

  close() {
    this.#resized.disconnect();
    this.#plot?.destroy();
    this.#plot = null;
  }

  #colour(n) {
    return this.#style.getPropertyValue(`--series-${(n % COLOURS) + 1}`);
  }

  #options(uPlot, banded) {
    const axis = axisOf(this.#style);
    const hidden = { stroke: "transparent", width: 0, points: { show: false } };
    const lines = this.#series.flatMap((series, n) => {
      const dash = DASHES[Math.floor(n / COLOURS) % DASHES.length];
      const line = { stroke: this.#colour(n), width: 2, dash, spanGaps: false, points: { show: series.values.length < 60, size: 5 } };
      return banded ? [line, hidden, hidden] : [line];
    });
    const bands = banded ? this.#series.map((_, n) => ({ series: [3 * n + 3, 3 * n + 2], fill: `color-mix(in srgb, ${this.#colour(n)} 22%, transparent)` })) : [];
    return {
      width: Math.max(this.area.clientWidth, 200), height: HEIGHT, legend: { show: false }, bands,
      cursor: { ...cursor, focus: { prox: NEAR_PX } },
      scales: { x: { time: true, range: () => spanOf(this.#trends) }, y: { range: (_, least, largest) => this.#range(least, largest) } },
      axes: [
        { ...axis, size: 4, values: (_, splits) => splits.map(() => null), space: 70 },
        { ...axis, size: LEFT_PX, space: 30, values: (_, splits) => splits.map((value) => value.toLocaleString(document.documentElement.lang)) },
      ],
      series: [{}, ...lines],
      hooks: { draw: [(plot) => this.#draw(plot)], setCursor: [(plot) => this.#moved(plot.cursor.idx)] },
    };
  }

  // Limits are in view when values come near them; a flat line lies in the middle.
  #range(least, largest) {
    if (least == null || largest == null) return [0, 1];
    const { lower, upper } = this.#series[0];
    if (upper === 0) return [-0.05, Math.max(1, largest) * 1.15]; // a count
    const reach = Math.max(largest - least, Math.abs(largest) * 0.02, 1e-6);
    const top = upper != null && upper - largest < 2 * reach ? Math.max(largest, upper) : largest;
    const bottom = lower != null && least - lower < 2 * reach ? Math.min(least, lower) : least;
    return [bottom - 0.12 * reach, top + 0.15 * reach];
  }

  #draw(plot) {
    const { ctx } = plot;
    const { left, top, width, height } = plot.bbox;
    const scale = devicePixelRatio;
    ctx.save();
    ctx.beginPath();
    ctx.rect(left, top, width, height);
    ctx.clip();
    ctx.lineWidth = 2 * scale;
    ctx.strokeStyle = ctx.fillStyle = this.#style.getPropertyValue("--caution");
    ctx.setLineDash([8 * scale, 5 * scale]);
    for (const limit of [this.#series[0].upper, this.#series[0].lower].filter(Boolean)) {
      const y = plot.valToPos(limit, "y", true);
      ctx.beginPath();
      ctx.moveTo(left, y);
      ctx.lineTo(left + width, y);
      ctx.stroke();
    }
    ctx.setLineDash([]);
    for (const series of this.#series) {
      series.values.forEach((_, n) => {
        const worst = this.#worst(series, n);
        if (!beyond(series, worst)) return;
        ctx.beginPath();
        ctx.arc(plot.valToPos(plot.data[0][n], "x", true), plot.valToPos(worst, "y", true), 4 * scale, 0, 7);
        ctx.fill();
      });
    }
    ctx.fillStyle = this.#style.getPropertyValue("--ink");
    for (const [, x] of marksOf(plot, this.#trends)) ctx.fillRect(x, top, scale, height);
    ctx.restore();
  }

  // The value of a time that lies furthest beyond a limit: of a bin, its largest or least value.
  #worst(series, n) {
    if (!series.least) return series.values[n];
    if (beyond(series, series.largest[n]) && series.upper != null) return series.largest[n];
    return series.lower == null ? series.values[n] : series.least[n];
  }

  #showParts() {
    const several = this.#series.length > 1 || this.#series[0].part;
    const names = several ? this.#series.map((series, n) => this.#entry(series, n)) : [];
    this.parts.replaceChildren(...names);
    const count = this.#series.reduce((sum, series) => sum + series.values.filter((_, n) => beyond(series, this.#worst(series, n))).length, 0);
    setText(this.warning, count ? `⚠ ${texts.trends.beyond(count)}` : "");
  }

  #entry(series, n) {
    const sample = make("span", { className: "chart-sample" });
    sample.style.borderTopColor = this.#colour(n);
    sample.style.borderTopStyle = ["solid", "dashed", "dotted", "double"][Math.floor(n / COLOURS) % 4];
    return make("li", {}, sample, series.part);
  }

  #moved(index) {
    if (index == null || index === this.#at) return;
    this.#at = index;
    this.#describe();
  }

  #describe() {
    const last = this.#trends.times.length - 1;
    const n = this.#at ?? last;
    const values = this.#series.map((series) => {
      if (series.values[n] == null) return "";
      const text = digits(this.#figure, series.values[n]);
      const said = series.least ? texts.trends.range(text, digits(this.#figure, series.least[n]), digits(this.#figure, series.largest[n])) : text;
      return `${series.part ? `${series.part} ` : ""}${said}`;
    });
    const { upper, lower } = this.#series[0];
    const limit = upper ?? lower;
    const text = [moment(this.#trends.times[n]), ...values.filter(Boolean)].join(" · ");
    setText(this.readout, limit == null ? text : `${text} · ${texts.trends.limit(limit.toLocaleString(document.documentElement.lang))}`);
    for (const [name, value] of Object.entries({ valuemin: 0, valuemax: last, valuenow: n, valuetext: text })) this.area.setAttribute(`aria-${name}`, value);
  }

  #key(event) {
    const last = this.#trends.times.length - 1;
    const steps = { ArrowLeft: -1, ArrowRight: 1, ArrowDown: -1, ArrowUp: 1, PageUp: -10, PageDown: 10, Home: -last, End: last };
    if (event.key === "Enter") this.#open(this.#far());
    else if (event.key in steps) {
      event.preventDefault();
      const n = Math.min(Math.max((this.#at ?? last) + steps[event.key], 0), last);
      this.#plot.setCursor({ left: this.#plot.valToPos(this.#plot.data[0][n], "x"), top: HEIGHT / 2 }, true, true); // the others follow
      this.#moved(n);
    }
  }

  get #shownAt() {
    return this.#at ?? this.#trends.times.length - 1;
  }

  // The line whose value or mark of the shown time lies next to this height, px.
  #near(top) {
    const n = this.#shownAt;
    const away = (value) => (value == null ? Infinity : Math.abs(this.#plot.valToPos(value, "y") - top));
    const distance = (series) => Math.min(away(series.values[n]), beyond(series, this.#worst(series, n)) ? away(this.#worst(series, n)) : Infinity);
    return this.#series.reduce((best, series) => (distance(series) < distance(best) ? series : best));
  }

  // The line that is beyond its limit at the shown time, or else the first: keys point at no line.
  #far() {
    return this.#series.find((series) => beyond(series, this.#worst(series, this.#shownAt))) ?? this.#series[0];
  }

  // The board of the point; of a bin, the one that lies furthest off, of this line.
  #open(line) {
    const n = this.#shownAt;
    const run = this.#trends.runs?.[n] ?? line.runs?.[n] ?? this.#series.map((series) => series.runs?.[n]).find(Boolean);
    if (run) location.hash = `#/board/${encodeURIComponent(run)}`;
  }

  #fit() {
    if (this.#plot && this.area.clientWidth) this.#plot.setSize({ width: this.area.clientWidth, height: HEIGHT });
  }
}
