// When everything of a run happened: barrier, pulses, LEDs, exposures, transfer and stitching of every row, drawn to scale.
import { make, saidOf } from "../parts/elements.js";
import * as rest from "../parts/rest.js";
import { svg, titled } from "../parts/svg.js";
import { number, texts } from "../texts/texts.js";

const [ROW_PX, HEAD_PX, LEFT_PX, RIGHT_PX, LEAST_WIDTH_PX] = [22, 52, 96, 24, 420];
const STEPS = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 60];
const LEAST_PX = 3; // exposures take a thousandth of a run: they are drawn at least this wide

// What every row did, in seconds since the barrier.
function rowsOf(timeline) {
  const count = Math.max(-1, ...timeline.rows.map((r) => r.row), ...timeline.frames_settled_s.map(([, row]) => row)) + 1;
  return Array.from({ length: count }, (_, row) => {
    const pulse = timeline.rows.find((r) => r.row === row);
    const arrivals = timeline.frames_settled_s.filter(([, r]) => r === row).map(([, , time]) => time);
    // A task belongs to the later of its rows, for whose frame it waited.
    const tasks = timeline.tasks.filter((t) => Math.max(t.row, t.other_row ?? t.row) === row);
    return { row, pulse, arrivals, tasks, done_s: tasks.length ? Math.max(...tasks.map((t) => t.done_s)) : null };
  });
}

export async function timing(root, run) {
  root.replaceChildren(make("p", { className: "note", textContent: texts.board.loading }));
  try {
    const timeline = await rest.timeline(run.id);
    const rows = rowsOf(timeline);
    if (!rows.length) return root.replaceChildren(make("p", { className: "note", textContent: texts.board.noTimes }));
    const width = Math.max(root.clientWidth - 30, LEAST_WIDTH_PX);
    root.replaceChildren(keys(), drawing(timeline, rows, width), table(timeline, rows));
  } catch (error) {
    if (!(error instanceof rest.Refusal)) throw error;
    root.replaceChildren(make("p", { className: "note" }, ...saidOf(error)));
  }
}

function keys() {
  const names = ["barrier", "pulse", "led", "exposure", "transfer", "waiting", "stitch", "result"];
  return make("ul", { className: "keys" }, ...names.map((name) => make("li", {}, make("span", { className: `key t-${name}` }), texts.board.times[name])));
}

function drawing(timeline, rows, width) {
  const end = Math.max(timeline.ready_s ?? 0, timeline.last_frame_s, ...rows.map((r) => r.done_s ?? 0), ...timeline.barrier.map((b) => b.clear_s ?? b.blocked_s)) * 1.02;
  const height = HEAD_PX + rows.length * ROW_PX + 26;
  const x = (time) => LEFT_PX + (time / end) * (width - LEFT_PX - RIGHT_PX);
  const picture = svg("svg", { width, height, class: "timing", role: "img" });
  picture.setAttribute("aria-label", texts.board.timingOf(rows.length));
  const bar = (name, from, to, y, high, title) =>
    picture.append(titled(svg("rect", { class: `t-${name}`, x: x(from), y, width: Math.max(x(to) - x(from), LEAST_PX), height: high }), title));
  const text = (at, y, words, anchor = "start") => {
    const element = svg("text", { x: at, y, "text-anchor": anchor });
    element.textContent = words;
    picture.append(element);
  };
  const ms = (from, to) => `${number((to - from) * 1000, 1)} ms`;
  const step = STEPS.find((s) => end / s <= width / 90) ?? STEPS.at(-1);
  for (let n = 0; n * step <= end; n++) {
    picture.append(svg("line", { class: "grid", x1: x(n * step), x2: x(n * step), y1: 20, y2: height - 22 }));
    text(x(n * step), height - 8, `${number(n * step, step < 0.01 ? 3 : step < 0.1 ? 2 : step < 1 ? 1 : 0)} s`, "middle");
  }
  text(4, 38, texts.board.times.barrier);
  for (const b of timeline.barrier) bar("barrier", b.blocked_s, b.clear_s ?? end, 26, 14, `${texts.board.times.barrier}: ${ms(b.blocked_s, b.clear_s ?? end)}`);
  for (const { row, pulse, arrivals, tasks } of rows) {
    const y = HEAD_PX + row * ROW_PX;
    text(4, y + 14, String(row));
    const last = arrivals.length ? Math.max(...arrivals) : null;
    if (pulse) {
      const open = pulse.pulse_s + pulse.exposure_us / 1e6;
      if (last != null) bar("transfer", open, last, y + 3, 8, `${texts.board.times.transfer}: ${ms(open, last)}`);
      bar("exposure", pulse.pulse_s, open, y + 3, 8, `${texts.board.times.exposure}: ${number(pulse.exposure_us)} µs`);
      if (pulse.led_us != null) bar("led", pulse.pulse_s, pulse.pulse_s + pulse.led_us / 1e6, y + 3, 4, `${texts.board.times.led}: ${number(pulse.led_us)} µs ${pulse.light}`);
      picture.append(titled(svg("line", { class: "t-pulse", x1: x(pulse.pulse_s), x2: x(pulse.pulse_s), y1: y, y2: y + 18 }), `${texts.board.times.pulse}: ${number(pulse.pulse_s, 4)} s`));
    }
    for (const at of arrivals) picture.append(svg("line", { class: "t-arrival", x1: x(at), x2: x(at), y1: y + 2, y2: y + 12 }));
    for (const task of tasks) {
      const worked = Math.max(task.ready_s, task.done_s - task.worker_ms / 1000);
      const what = `${texts.board.times.stitch}: ${task.camera}/${task.row}${task.other_camera == null ? "" : ` – ${task.other_camera}/${task.other_row}`}, ${number(task.worker_ms, 1)} ms`;
      bar("waiting", task.ready_s, worked, y + 13, 2, texts.board.times.waiting);
      bar("stitch", worked, task.done_s, y + 12, 6, what);
    }
  }
  for (const [name, at] of [["last", timeline.last_frame_s], ["result", timeline.ready_s]]) {
    if (at == null) continue;
    picture.append(svg("line", { class: `t-${name}`, x1: x(at), x2: x(at), y1: 20, y2: height - 22 }));
    if (name === "result") text(Math.min(x(at), width - 4), 12, texts.board.times.result, "end");
  }
  return make("div", { className: "scrolled", tabIndex: 0 }, picture);
}

function table(timeline, rows) {
  const head = make("tr", {}, ...texts.board.timeColumns.map((textContent) => make("th", { scope: "col", textContent })));
  const body = rows.map(({ row, pulse, arrivals, done_s }) => {
    const last = arrivals.length ? Math.max(...arrivals) : null;
    const after = (time) => (time == null || !pulse ? "" : number((time - pulse.pulse_s) * 1000, 1));
    const cells = [row, pulse ? number(pulse.pulse_s, 4) : "", pulse?.light ?? "", pulse?.led_us == null ? "" : number(pulse.led_us), pulse ? number(pulse.exposure_us) : "", after(last), after(done_s)];
    return make("tr", {}, ...cells.map((textContent) => make("td", { textContent })));
  });
  const ready = timeline.ready_s == null ? "" : texts.board.readyAt(number(timeline.ready_s, 3), number((timeline.ready_s - timeline.last_frame_s) * 1000, 1));
  return make("div", {}, make("p", { textContent: ready }), make("div", { className: "scrolled", tabIndex: 0 }, make("table", { className: "times" }, make("thead", {}, head), make("tbody", {}, ...body))));
}
