// The guide of a calibration: the grid as it appears, what each marker lacks, and the result.
const $ = (id) => document.getElementById(id);
const TURNS = { 1: Math.PI, 2: 0, 3: -Math.PI / 2, 4: Math.PI / 2 }; // the way that a marker should go
const ENOUGH_WAY = 0;
const SLOW_S = 15;

export function drawGuide(sensor, guide, arrays) {
  if (!guide || !arrays.guide_px) return;
  const { context, tone, zoom } = sensor, ratio = devicePixelRatio;
  const radius = guide.radius_px * zoom;
  for (let marker = 0; marker < arrays.guide_share.length; marker++) {
    const [x, y] = sensor.toCanvas(arrays.guide_px[2 * marker], arrays.guide_px[2 * marker + 1]);
    const share = arrays.guide_share[marker] / 255, way = arrays.guide_way[marker];
    context.lineWidth = 2.5 * ratio;
    context.strokeStyle = tone.disc;
    circle(context, x, y, radius + 3 * ratio, 0, 2 * Math.PI);
    context.strokeStyle = way === ENOUGH_WAY ? tone.good : tone.arrow;
    circle(context, x, y, radius + 3 * ratio, -Math.PI / 2, -Math.PI / 2 + 2 * Math.PI * (way === ENOUGH_WAY ? 1 : share));
    context.fillStyle = context.strokeStyle;
    if (way === ENOUGH_WAY) tick(context, x, y, 0.4 * radius);
    else pointer(context, x, y, TURNS[way], 0.7 * radius);
  }
}

export function showGuide(guide, hello) {
  if ($("guide").hidden === Boolean(guide)) $("guide").hidden = !guide;
  if (!guide) return;
  $("guide").dataset.state = guide.state;
  const total = guide.markers;
  write("guide-advice", { calibrating: "Calibrating. You may go on watching.", failed: "The calibration failed.", done: "Calibrated." }[guide.state] ?? guide.advice[0]);
  write("guide-more", guide.state === "guide" ? guide.advice.slice(1).join(" ") : guide.state === "calibrating" ? runningText(guide.running_s ?? 0) : guide.said);
  const live = guide.state === "guide" || guide.state === "failed";
  $("guide-progress").hidden = $("guide-count").hidden = !live;
  Object.assign($("guide-progress"), { max: Math.max(total, 1), value: guide.enough });
  write("guide-count", total
    ? `${guide.enough} of ${total} markers have moved enough, ${guide.grid ? `grid ${guide.grid.join(" × ")}` : "no rows"}, ${guide.rests} ${guide.rests === 1 ? "rest" : "rests"}`
    : "no markers yet");
  $("calibrate").hidden = $("begin-anew").hidden = !live;
  $("calibrate").classList.toggle("ready", guide.ready);
  write("calibrate", guide.state === "failed" ? "Calibrate again" : "Calibrate");
  write("guide-path", guide.state === "guide" ? `It will be saved as ${guide.path}. The same without the page: ${guide.command}` : "");
  showResult(guide.result, hello);
}

function showResult(result, hello) {
  $("guide-result").hidden = !result;
  if (!result || $("guide-result").dataset.shown === JSON.stringify(result)) return;
  $("guide-result").dataset.shown = JSON.stringify(result);
  const rows = [
    ["quality", result.quality],
    ["grid", `${result.grid ? result.grid.join(" × ") : "no rows"}, ${result.polarity} markers`],
    ["markers measured", `${result.measured} of ${result.markers}`],
    ["explained by discs", `${(100 * result.explained).toFixed(0)} % of the changes`],
    ["radius", `${result.radius_px.toFixed(2)} px`],
    ["doubtful", names(result.doubtful, result.grid) || "none"],
    ["not measured", names(result.missing, result.grid) || "none"],
  ];
  $("guide-result").replaceChildren(...rows.flatMap(([title, text]) => {
    const term = document.createElement("dt"), value = document.createElement("dd");
    [term.textContent, value.textContent] = [title, text];
    return [term, value];
  }));
}

function runningText(seconds) {
  return `${seconds.toFixed(0)} s${seconds > SLOW_S ? "; the first one on a machine compiles, which may take a minute" : ""}`;
}

function names(markers, grid) {
  if (!grid) return markers.join(", ");
  const columns = grid[1];
  return markers.map((marker) => `row ${Math.floor(marker / columns) + 1} column ${marker % columns + 1}`).join(", ");
}

function write(id, text) {
  if ($(id).textContent !== text) $(id).textContent = text;
}

function circle(context, x, y, radius, from, to) {
  context.beginPath();
  context.arc(x, y, radius, from, to);
  context.stroke();
}

function tick(context, x, y, size) {
  context.beginPath();
  context.moveTo(x - size, y);
  context.lineTo(x - 0.2 * size, y + 0.7 * size);
  context.lineTo(x + size, y - 0.7 * size);
  context.stroke();
}

function pointer(context, x, y, turn, size) {
  context.beginPath();
  for (const [along, aside] of [[1, 0], [-0.6, 0.8], [-0.6, -0.8]]) {
    context.lineTo(x + size * (along * Math.cos(turn) - aside * Math.sin(turn)), y + size * (along * Math.sin(turn) + aside * Math.cos(turn)));
  }
  context.fill();
}
