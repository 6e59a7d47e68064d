// The table of figures, and what a screen reader is told.
const ORDER = [
  ["force", "force x, y, z"], ["slip", "slip"], ["vibration", "vibration"],
  ["largest", "largest displacement"], ["error", "error against truth"], ["held", "markers"],
  ["rate", "event rate"], ["on", "ON share"], ["noise", "noise per pixel"], ["hot", "hot pixels"], ["estimates", "estimates"], ["step", "step p50, p99"], ["pace", "pace"],
  ["draw", "stamp to draw p50, p99"], ["fps", "drawn"],
  ["late", "frames late"], ["watchdog", "watchdog"], ["damage", "damaged or lost"],
];

export class Readings {
  constructor(list) {
    this.cells = {};
    for (const [key, title] of ORDER) {
      const term = document.createElement("dt"), value = document.createElement("dd");
      term.textContent = title;
      value.dataset.testid = `reading-${key}`;
      list.append(term, value);
      this.cells[key] = [term, value];
    }
  }

  show(key, text, poor = false) {
    const [term, value] = this.cells[key];
    term.hidden = value.hidden = text === null;
    if (value.textContent !== text) value.textContent = text ?? "";
    value.classList.toggle("poor", poor);
  }
}

export function length(px, pxPerMm) {
  return pxPerMm ? `${px.toFixed(2)} px (${(px / pxPerMm).toFixed(3)} mm)` : `${px.toFixed(2)} px`;
}

export function eventRate(perSecond) {
  return perSecond >= 1e6 ? `${(perSecond / 1e6).toFixed(2)} Mev/s` : `${(perSecond / 1e3).toFixed(1)} kev/s`;
}

export function fieldOf(hello, { position_px: position, truth_px: truth, detected_px: detected, held, confidence }) {
  if (!position) return null;
  let largest = 0, at = 0, error = 0, sustained = 0, lost = 0;
  hello.reference_px.forEach(([rx, ry], marker) => {
    const moved = Math.hypot(position[2 * marker] - rx, position[2 * marker + 1] - ry);
    if (moved > largest) [largest, at] = [moved, marker];
    if (truth) error += Math.hypot(detected[2 * marker] - truth[2 * marker], detected[2 * marker + 1] - truth[2 * marker + 1]);
    if (held[marker]) sustained++;
    if (held[marker] && confidence[marker] === 0) lost++;
  });
  return { largest, at, error: truth ? error / hello.reference_px.length : null, sustained, lost };
}
