// Fehler eines Lichtprogramms, und was an ihm nicht geprüft ist, nach ihrem Code (docs/codes.md), mit den Werten, die der Satz der Station nennt.
const QUANTITIES = { exposure_us: "die Belichtung", gain_db: "die Verstärkung", on_us: "die Leuchtdauer", exposure: "Belichtung", gain: "Verstärkung" };
const quantity = (field) => QUANTITIES[field] ?? field;
const of = (cameras) => cameras.replaceAll(/(^|, )camera /g, "$1Kamera ");

export const program = {
  "beyond-camera": ({ camera, field, value, low, high }) => `${of(camera)}: ${value} ist für ${quantity(field)} zu viel oder zu wenig; die Kamera nennt ${low} … ${high}.`,
  "board-too-long": ({ value, most }) => `Die längste Baugruppe dieses Typs ist mit ${value} mm länger als die der Linie, ${most} mm.`,
  "camera-limits-not-stated": ({ camera, field }) => `${of(camera)} nennt keine Grenzen für ${quantity(field)}.`,
  "camera-limits-unknown": ({ camera }) => `Die Grenzen von ${of(camera)} sind unbekannt: Sie ist nicht verbunden.`,
  "controller-limits-unknown": () => "Die Grenzen der Steuerung sind unbekannt: Sie hat sich noch nicht gemeldet.",
  "exposure-beyond-period": ({ camera, value, most }) => `${of(camera)}: ${value} µs Belichtung sind zu lang; bis zur nächsten Reihe bleiben ${most} µs. Kürzer belichten.`,
  "line-against-encoder": () => "Abstand und Geschwindigkeit der Reihen passen nicht zum Encoder. `line` des Typs oder [line.encoder] berichtigen.",
  "line-value-beyond": ({ field, value, low, high }) => `${field} ist ${value}; station.toml erlaubt ${low} … ${high}.`,
  "line-value-fixed": ({ field, value, only, limits }) => `${field} ist ${value}; station.toml hat ${only} und erlaubt keinen anderen Wert, solange ${limits} fehlt.`,
  "line-without-rail": () => "Der Typ nennt line.rail_mm, aber an dieser Linie führt keine Schiene die Baugruppen.",
  "motion-blur": ({ camera, field, value, most, blur }) => `${of(camera)}: ${value} µs Licht sind zu lang; in mehr als ${most} µs bewegt sich das Bild um mehr als ${blur} px. ${field === "on_us" ? "Kürzer leuchten lassen" : "Kürzer belichten"} oder mehr verstärken.`,
  "no-such-channel": ({ light, channel, channels }) => `Licht ${light} nennt den LED-Kanal ${channel}; die Steuerung hat die Kanäle unter ${channels}.`,
  "on-time-beyond": ({ light, value, low, high }) => `Licht ${light}: ${value} µs Leuchtdauer; die Steuerung erlaubt ${low} … ${high} µs.`,
  "one-trigger-width": ({ camera, other, value, only }) => `${of(camera)} soll ${value} µs belichten, ${of(other)} in derselben Reihe ${only} µs; ein Auslöser gibt beiden dieselbe Belichtung.`,
  "one-value-for-all-rows": ({ camera, field, value, only }) => `${of(camera)}: ${value} in dieser Reihe, ${only} in der ersten; ${quantity(field)} ist bei dieser Kamera in allen Reihen gleich. Reihen durch die Leuchtdauer unterscheiden.`,
  "one-width-for-all-rows": ({ version }) => `Die Firmware ${version} der Steuerung gibt allen Reihen dieselbe Belichtung über die Breite des Auslösers; ab 1.3.0 jeder eine eigene.`,
  "period-too-short": ({ camera, value, least, exposure }) => `${of(camera)}: Reihen folgen alle ${value} s; ${exposure} µs Belichtung und das Auslesen brauchen ${least} s.`,
  "sequencer-too-short": ({ camera, count, most }) => `${of(camera)}: Das Programm braucht ${count} verschiedene Einstellungen, die Kamera hat Platz für ${most}. Reihen durch die Leuchtdauer unterscheiden.`,
  "sequencer-unproven": ({ cameras }) => `Ob ${of(cameras)} mit jedem Einzelbild zur nächsten Einstellung übergeht, zeigt sich beim Aktivieren.`,
  "steps-too-alike": ({ camera, field, value, other }) => `${of(camera)}: ${value} liegt zu nahe am Wert von Reihe ${other}; nach dem, was die Einzelbilder über ${quantity(field)} angeben, wären die zwei nicht zu unterscheiden.`,
  "tail-too-long": ({ value, rows, slots }) => `Mit ${value} s Nachlauf (line.tail_s) sind es ${rows} Reihen; der Bildspeicher hat Platz für ${slots}.`,
  "tail-too-short": ({ value, least }) => `Mit ${value} s Nachlauf (line.tail_s) wird keine Reihe aufgenommen; nötig sind ${least} s.`,
  "too-many-steps": ({ count, most }) => `${count} Schritte sind zu viele; die Steuerung hat Platz für ${most}.`,
  "trigger-width-beyond": ({ value, low, high }) => `${value} µs Belichtung über die Breite des Auslösers; möglich sind ${low} … ${high} µs.`,
  "trigger-width-unproven": ({ cameras }) => `Ob ${of(cameras)} so lange belichtet, wie der Auslöser breit ist, zeigt sich beim Aktivieren.`,
  "unknown-light": ({ light, known }) => `Das Licht ${light} gibt es nicht${known ? `; es gibt ${known}` : ""}.`,
  "values-per-camera": ({ count, cameras }) => `${count} Werte; nötig ist einer für alle Kameras, oder ${cameras}, einer je Kamera.`,
};
