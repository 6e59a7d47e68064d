// Draws what is felt over the sensor: the touched patch, the force as an arrow, the spectrum.
import { drawSeen } from "./arrows.js";
import { fitCanvas } from "./theme.js";

const PX_PER_N = 25; // sensor pixels of arrow for a newton along the skin

export function drawFelt(sensor, felt) {
  if (!felt?.force_n) return;
  const { context, hello, tone } = sensor;
  context.strokeStyle = context.fillStyle = tone.force;
  if (felt.outline_px?.length > 2) {
    context.lineWidth = 2 * devicePixelRatio;
    context.beginPath();
    felt.outline_px.forEach(([x, y]) => context.lineTo(...sensor.toCanvas(x, y)));
    context.closePath();
    context.stroke();
  }
  const [x, y] = felt.place_px ?? hello.size.map((side) => side / 2), [fx, fy] = felt.force_n;
  const ends = [sensor.toCanvas(x, y), sensor.toCanvas(x + PX_PER_N * fx, y + PX_PER_N * fy), Math.hypot(fx, fy) * PX_PER_N];
  drawSeen(context, [[context.fillStyle, [ends]]]);
}

export function forceText(felt) {
  if (!felt?.force_n) return null;
  const { force_n: force, half_width_n: half } = felt;
  const [x, y, z] = force.map((value, i) => `${value.toFixed(2)} ± ${half[i].toFixed(2)}`);
  return `${x}, ${y}, ${z} N`;
}

export function slipText(felt) {
  if (!felt?.force_n) return null;
  if (!felt.slip) return "no contact";
  const said = { stick: "sticks", incipient: "slips in part", gross: "slips" }[felt.slip];
  return `${said}, ${(100 * felt.sticking_share).toFixed(0)} % sticks`;
}

export function vibrationText(felt, pxPerMm) {
  if (!felt?.force_n) return null;
  if (felt.line_hz === null) return "none";
  const amplitude = pxPerMm ? `${(1e3 * felt.line_px / pxPerMm).toFixed(1)} µm` : `${felt.line_px.toFixed(3)} px`;
  return `${felt.line_hz.toFixed(1)} Hz, ${amplitude}`;
}

export function drawSpectrum(canvas, felt, color) {
  canvas.closest("figure").hidden = !felt?.spectrum_px?.length;
  if (!felt?.spectrum_px?.length) return;
  fitCanvas(canvas);
  const context = canvas.getContext("2d"), { width, height } = canvas;
  context.clearRect(0, 0, width, height);
  context.fillStyle = color;
  const top = Math.max(...felt.spectrum_px, 1e-6), step = width / felt.spectrum_px.length;
  felt.spectrum_px.forEach((value, i) => context.fillRect(i * step, height, Math.max(step, 1), -height * value / top));
}
