// Warnungen einer Kalibrierung nach ihrem Code (docs/codes.md), mit den Werten, die der Satz der Station nennt.
const of = (cameras) => (cameras.includes(",") ? `Kameras ${cameras}` : `Kamera ${cameras}`);

export const notes = {
  "corners-uncertain": ({ cameras, sigma_px }) => `${of(cameras)}: In den Ecken des Bilds bleibt eine Unsicherheit von ± ${sigma_px} px (1 σ); Marken bis in die Ecken aufnehmen.`,
  "four-marks": ({ cameras }) => `${of(cameras)}: Vier Marken bestimmen die Lage ohne Überschuss: Die Restfehler sind immer 0 und prüfen nichts.`,
  "layout-symmetric": () => "Das Layout ist gespiegelt oder gedreht dasselbe; die Richtung in layout.json lässt sich nicht prüfen. Eine weitere Marke außerhalb des Musters würde sie eindeutig machen.",
  "lens-undetermined": ({ cameras, count, sigma_px }) => `${of(cameras)}: ${count} Marken bestimmen das Objektiv nicht: ± ${sigma_px} px in den Ecken (1 σ); 9 oder mehr Marken aufnehmen.`,
  "mark-unused": ({ cameras, at_px }) => `${of(cameras)}: Die Marke bei (${at_px}) px wurde nicht verwendet.`,
  "nominal-view-decided": ({ cameras, shift_mm, tolerance_mm }) => `${of(cameras)}: Das um (${shift_mm}) mm verschobene Layout erklärt die Marken ebenso; nominal_center_mm, auf ± ${tolerance_mm} mm genau, hat entschieden.`,
  "print-scale": ({ percent }) => `Alle Kameras sehen das Muster um ${percent} % anders als entworfen: Maßstab des Ausdrucks und nominal_px_per_mm prüfen.`,
  "view-off-nominal": ({ cameras, off_mm, tolerance_mm }) => `${of(cameras)}: Das Bildfeld liegt ${off_mm} mm neben nominal_center_mm, mehr als die angegebenen ± ${tolerance_mm} mm.`,
};
