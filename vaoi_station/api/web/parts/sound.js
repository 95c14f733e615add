// A tone when a fault comes, if it is switched on. Browsers play nothing before the first touch of the page.
import { keep, kept } from "./settings.js";

let context = null;
export const isOn = () => kept("sound", "on") === "on";
export const switchTo = (on) => keep("sound", on ? "on" : "off");

export function alarm() {
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
