// A tone when a fault comes, if it is switched on. Browsers play nothing before the first touch of the page.
import { QUIET } from "./orders.js";
import { keep, kept } from "./settings.js";

let context = null;
const announced = new Set(); // the fault and the failed boards for which the tone was played
export const isOn = () => kept("sound", "on") === "on";
export const switchTo = (on) => keep("sound", on ? "on" : "off");

// Once for a fault or a failed board, however many boards pass and whatever else holds the line meanwhile.
export function announce({ state, shown, tone, board }) {
  if (QUIET.includes(state)) announced.delete("faulted");
  if (tone !== "fault") return;
  const subject = shown === "failed" ? board.id : shown;
  if (!announced.has(subject)) alarm();
  announced.add(subject);
}

function alarm() {
  if (!isOn() || !("AudioContext" in window)) return;
  context ??= new AudioContext();
  if (context.state === "suspended") context.resume().catch(() => {});
  const [tone, volume] = [context.createOscillator(), context.createGain()];
  tone.frequency.value = 880;
  volume.gain.setValueAtTime(0.2, context.currentTime);
  volume.gain.setValueAtTime(0, context.currentTime + 0.25);
  volume.gain.setValueAtTime(0.2, context.currentTime + 0.4);
  tone.connect(volume).connect(context.destination);
  tone.start();
  tone.stop(context.currentTime + 0.8);
}
