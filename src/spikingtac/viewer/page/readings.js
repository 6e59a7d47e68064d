// The table of figures, and what a screen reader is told.
const ORDER = [
  ["force", "force x, y, z", "Force on the skin, with the half width of its 90 % interval."],
  ["slip", "grip", "Whether what touches the skin sticks or slips, and which share of the contact still sticks."],
  ["vibration", "vibration", "The strongest frequency of the skin's motion, and how far it swings."],
  ["largest", "largest displacement", "Of all markers, now."],
  ["error", "mean error", "Mean distance of the tracked markers from the simulation's truth."],
  ["held", "markers", "Seen ones; held ones are not seen and are put where they are expected; lost ones were not seen for long."],
  ["rate", "events per second", "Changes of brightness that the camera reports, over the last half second."],
  ["on", "brighter events", "Share of the events that say 'brighter'. A camera with even thresholds has about half."],
  ["noise", "noise per pixel", "Events of each pixel while nothing moves."],
  ["hot", "hot pixels", "Pixels that report far more than the noise of the others."],
  ["estimates", "tracked", "How often the displacement is estimated in a second of the recording."],
  ["step", "time for an estimate", "Typical, and the slowest one in a hundred."],
  ["pace", "playing speed", "Seconds of the recording that pass in a second."],
  ["draw", "delay of the picture", "From the estimate to the drawn picture: typical, and the slowest one in a hundred."],
  ["fps", "pictures per second", "Drawn by this page."],
  ["late", "late pictures", "Pictures that were not ready in time."],
  ["damage", "damaged or lost data", "What was wrong with the stream, by kind, and how often."],
];

const LEAST_MM = 0.01;

export class Readings {
  constructor(list) {
    this.cells = {};
    for (const [key, title, about] of ORDER) {
      const term = document.createElement("dt"), value = document.createElement("dd");
      term.textContent = title;
      term.title = value.title = about;
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
  if (!pxPerMm) return `${px.toFixed(2)} px`;
  const mm = px / pxPerMm; // a noise of some micrometres is not 0.00 mm
  return `${px.toFixed(2)} px (${mm < LEAST_MM ? `${(1e3 * mm).toFixed(1)} µm` : `${mm.toFixed(3)} mm`})`;
}

export function eventRate(perSecond) {
  if (perSecond >= 1e6) return `${(perSecond / 1e6).toFixed(2)} million`;
  return perSecond >= 1e3 ? `${(perSecond / 1e3).toFixed(1)} thousand` : perSecond.toFixed(0);
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
