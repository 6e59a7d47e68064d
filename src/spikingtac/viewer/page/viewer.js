// Connects, draws the latest frame at the display's rate, acknowledges what was drawn.
import { Counts, Overview, Trace } from "./charts.js";
import { buildControls, refreshControls } from "./controls.js";
import { Course } from "./course.js";
import { drawFelt, drawSpectrum, forceText, slipText, vibrationText } from "./felt.js";
import { drawGuide, showGuide } from "./guide.js";
import { showHealth, steady } from "./health.js";
import { listen } from "./keys.js";
import { legendKeys, showLegend } from "./legend.js";
import { Readings, eventRate, fieldOf, length } from "./readings.js";
import { savePicture, saveTable } from "./save.js";
import { Sensor } from "./sensor.js";
import { onResize, startTheme } from "./theme.js";
import { decode } from "./wire.js";

const RETRY_MS = 1000;
const STALE_MS = 1500;
const STRIP_US = 2e6;
const SPEAK_MS = 4000;
const CHARTS_EVERY = 3; // pictures of the sensor
const SLOW_MS = 200; // figures that change faster cannot be read
const EXPOSURES_MS = [1, 200];
const LAYERS = ["arrows", "heat", "mesh", "discs", "truth"];

const $ = (id) => document.getElementById(id);
const sensor = new Sensor($("sensor")), counts = new Counts($("counts")), trace = new Trace($("trace"));
const course = new Course($("course")), overview = new Overview($("overview")), readings = new Readings($("readings"));
const metrics = { frames: 0, fps: 0, latencies_ms: [], draw_ms: [], arrows: [], sample: null, connected: false, hello: null, meta: null, states: [], saved: null, send };
window.__m = metrics;

let socket, hello, frame, drawn, waiting = false, receivedAt = 0, scrubbing = false, drawnAt = [], slowAt = 0, spokenAt = 0;

// Nobody sees a course grow sixty times a second. All are drawn with the same picture of the sensor:
// the browser puts together anew all that lies between what has changed.
const CHARTS = [
  (meta) => write($("count"), String(counts.draw(meta, hello.window_us) ?? "")),
  (meta) => hello.reference_px.length && trace.draw(meta, sensor.options.truth),
  (meta) => hello.reference_px.length && course.draw(meta, sensor.options.marker, hello.ends),
];

function send(command) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(command));
}

function connect() {
  const scheme = location.protocol === "https:" ? "wss:" : "ws:";
  socket = new WebSocket(`${scheme}//${location.host}/socket${location.search}`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { metrics.connected = true; send({ map: sensor.options.image === "map" }); };
  socket.onclose = () => { metrics.connected = false; setState("CLOSED"); setTimeout(connect, RETRY_MS); };
  socket.onmessage = ({ data }) => (typeof data === "string" ? greet(JSON.parse(data)) : receive(data));
}

function greet(document_) {
  $("label").textContent = document_.label;
  document.title = `${document_.label} · spikingtac`;
  $("origin").hidden = !document_.simulated;
  if (document_.starting) {
    setState("STARTING");
    $("waiting").textContent = document_.starting;
    return;
  }
  const names = (from) => from.controls.map((control) => control.name).join();
  const first = !hello || names(hello) !== names(document_);
  const other = !hello || JSON.stringify(hello.reference_px) !== JSON.stringify(document_.reference_px);
  hello = metrics.hello = document_;
  if (other) {
    forget();
    counts.clear();
    sensor.options.marker = $("marker").value = middle(hello);
  }
  sensor.greet(hello);
  if (first) buildControls($("controls"), hello.controls, (name, value) => { forget(); send({ set: [name, value] }); });
  else refreshControls($("controls"), hello.controls);
  const markers = hello.reference_px.length > 0;
  $("tuning").hidden = hello.controls.length === 0;
  $("truth-option").hidden = !hello.truth || !markers;
  $("unit").value = "px";
  for (const id of ["course", "trace"]) $(id).closest("figure").hidden = !markers;
  for (const id of ["arrows", "heat", "mesh", "discs", "scale"]) $(id).closest("label").hidden = !markers;
  $("save").hidden = !markers;
}

// The marker nearest to the middle of the image: it moves in most contacts.
function middle({ reference_px: places, size }) {
  const far = places.map(([x, y]) => Math.hypot(x - size[0] / 2, y - size[1] / 2));
  return places.length ? far.indexOf(Math.min(...far)) : 0;
}

// Other markers, or other settings: what was drawn before says nothing about them.
function forget() {
  course.clear();
  trace.clear();
}

function receive(buffer) {
  // Only the latest frame is kept; it is drawn at the display's next opportunity.
  if (frame) send({ ack: metrics.frames });
  frame = buffer;
  receivedAt = performance.now();
  if (!waiting) {
    waiting = true;
    requestAnimationFrame(draw);
  }
}

function draw() {
  waiting = false;
  if (!frame || !hello) return;
  const begun = performance.now(), { meta, arrays } = (drawn = decode(frame));
  frame = null;
  if ($("sensor").hidden) {
    document.body.classList.remove("starting");
    show("sensor", true);
    show("waiting", false);
  }
  counts.add(meta, arrays.counts);
  sample(meta, arrays);
  const whole = metrics.frames % CHARTS_EVERY === 0 || !meta.playing;
  paint(whole);
  if (whole) showTime(meta);
  showMoment(meta);
  measure(meta);
  send({ ack: ++metrics.frames });
  if (performance.now() - slowAt > SLOW_MS) showReadings(meta, arrays);
  metrics.draw_ms.push(performance.now() - begun);
  if (metrics.draw_ms.length > 600) metrics.draw_ms.shift();
}

// What is drawn of the latest frame: the sensor, and now and then what stands around it.
function paint(whole = true) {
  const { meta, arrays } = drawn;
  sensor.top = course.top;
  sensor.draw(drawn);
  drawFelt(sensor, meta.felt);
  drawGuide(sensor, meta.guide, arrays);
  if (!whole) return;
  for (const chart of CHARTS) chart(meta);
  overview.draw(hello.overview, meta);
}

function sample(meta, { position_px: position, truth_px: truth }) {
  if (!position || 2 * hello.reference_px.length !== position.length) return;
  const marker = sensor.options.marker, [rx, ry] = hello.reference_px[marker];
  // Back in time, what was drawn of the seconds before is still known.
  if (meta.estimate_us < trace.samples.at(-1)?.t_us) trace.fill(course.of(marker, meta.estimate_us - STRIP_US, meta.estimate_us - 1));
  course.add(meta.estimate_us, meta.t_start_us, position, hello.reference_px);
  // The markers are where they were at the last estimate time, a little before the time shown.
  trace.add({
    t_us: meta.estimate_us, dx: position[2 * marker] - rx, dy: position[2 * marker + 1] - ry,
    truthX: truth && truth[2 * marker] - rx, truthY: truth && truth[2 * marker + 1] - ry,
  });
}

// Each of these makes the browser lay out some text; while it plays, nobody reads every one.
function showTime(meta) {
  const since = (meta.t_us - meta.t_start_us) / 1e6;
  write($("clock"), `${since.toFixed(3)} s`);
  if (!scrubbing) Object.assign($("timeline"), { min: meta.t_start_us, max: meta.t_end_us, value: meta.t_us });
  $("timeline").setAttribute("aria-valuetext", `${since.toFixed(2)} seconds`);
}

function showMoment(meta) {
  write($("play"), meta.playing ? "Pause" : "Play");
  if ($("play").ariaPressed !== String(meta.playing)) $("play").ariaPressed = String(meta.playing);
  setState(steady(meta.state), meta.failure);
  show("notice", Boolean(meta.notice));
  write($("notice"), meta.notice);
  const last = meta.contacts_us.at(-1), lamp = $("lamp"), [, word, since_] = lamp.children;
  show("lamp", true);
  lamp.classList.toggle("lit", meta.in_contact);
  write(word, meta.in_contact ? "CONTACT" : "free");
  write(since_, last === undefined ? "" : `${meta.in_contact ? "since" : "last at"} ${((last - meta.t_start_us) / 1e6).toFixed(3)} s`);
  showGuide(meta.guide, hello);
}

function measure(meta) {
  const now = performance.now();
  metrics.meta = meta;
  metrics.arrows = sensor.arrows;
  metrics.sample = trace.samples.at(-1);
  metrics.latencies_ms.push(performance.timeOrigin + now - meta.stamp_ms);
  if (metrics.latencies_ms.length > 600) metrics.latencies_ms.shift();
  drawnAt.push(now);
  drawnAt = drawnAt.filter((at) => now - at < 1000);
  metrics.fps = drawnAt.length;
}

function showReadings(meta, arrays) {
  slowAt = performance.now();
  const sorted = [...metrics.latencies_ms].sort((a, b) => a - b), at = (share) => sorted[Math.floor(share * (sorted.length - 1))];
  const field = arrays.position_px?.length === 2 * hello.reference_px.length ? fieldOf(hello, arrays) : null;
  const losses = Object.entries(meta.losses), quality = hello.quality;
  readings.show("force", forceText(meta.felt));
  readings.show("slip", slipText(meta.felt), meta.felt?.slip === "gross");
  readings.show("vibration", vibrationText(meta.felt, hello.px_per_mm));
  drawSpectrum($("spectrum"), meta.felt, sensor.tone.arrow);
  if (meta.felt?.spectrum_px?.length) $("spectrum-end").value = (meta.felt.spectrum_hz * meta.felt.spectrum_px.length).toFixed(0);
  readings.show("largest", field && `${length(field.largest, hello.px_per_mm)}`);
  readings.show("error", field?.error == null ? null : `${field.error.toFixed(3)} px`);
  readings.show("held", field && markersText(field), field?.sustained > 0);
  readings.show("rate", eventRate(meta.events_per_s));
  readings.show("on", quality && (quality.on_fraction === null ? "no events" : `${(100 * quality.on_fraction).toFixed(1)} %`));
  readings.show("noise", quality && `${quality.noise_hz.toPrecision(2)} events/s`);
  readings.show("hot", quality && String(quality.hot_pixels), quality?.hot_pixels > 0);
  readings.show("estimates", quality ? null : `${hello.rate_hz} per s`);
  readings.show("step", quality ? null : `${meta.step_p50_us.toFixed(0)} µs, ${meta.step_p99_us.toFixed(0)} µs`);
  readings.show("pace", meta.playing ? `× ${meta.pace.toFixed(2)}` : "paused", meta.playing && meta.pace < 0.9 * meta.speed);
  readings.show("draw", `${at(0.5).toFixed(0)} ms, ${at(0.99).toFixed(0)} ms`);
  readings.show("fps", String(metrics.fps));
  readings.show("late", String(meta.overruns));
  readings.show("damage", losses.length ? losses.map(([kind, times]) => `${kind.replaceAll("_", " ")} ${times}`).join(", ") : "none", losses.length > 0);
  showLegend($("legend"), legendKeys(sensor.options, hello, meta, arrays), scaleShown() && { top: sensor.top, pxPerMm: hello.px_per_mm });
  const moved = trace.samples.at(-1);
  if (moved) $("displacement").value = length(Math.hypot(moved.dx, moved.dy), hello.px_per_mm);
  if (field) $("largest").value = `now at most ${length(field.largest, hello.px_per_mm)}`;
  if (field && slowAt - spokenAt > SPEAK_MS) {
    spokenAt = slowAt;
    $("sensor").setAttribute("aria-label",
      `${hello.reference_px.length} markers; the largest displacement is ${length(field.largest, hello.px_per_mm)} at marker ${field.at}; ${field.sustained} held`);
  }
}

function scaleShown() {
  return hello.reference_px.length > 0 && (sensor.options.arrows || sensor.options.heat);
}

function markersText({ sustained, lost }) {
  const seen = hello.reference_px.length - sustained;
  return sustained ? `${seen} seen, ${sustained - lost} held, ${lost} lost` : `${seen} seen`;
}

// What is as it should be is left alone: to say it again makes the browser look at its styles.
function show(id, shown) {
  if ($(id).hidden === shown) $(id).hidden = !shown;
}

function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

function setState(state, failure = null) {
  if (metrics.states.at(-1) !== state) metrics.states.push(state);
  showHealth($("health"), state, failure);
}

function redraw() {
  if (!hello) return;
  sensor.recolor();
  if (!drawn) return;
  paint();
  metrics.arrows = sensor.arrows;
  slowAt = 0;
  showReadings(drawn.meta, drawn.arrays);
}

function setOption(name, value) {
  sensor.options[name] = value;
  if (name === "image") send({ map: value === "map" });
  if (name === "marker") {
    $("marker").value = value;
    const now = drawn?.meta.t_us ?? 0;
    trace.fill(course.of(value, now - STRIP_US, now));
    metrics.sample = trace.samples.at(-1);
  }
  if (name === "scale") $("scale-text").value = `× ${value}`;
  redraw();
}

function seek(tUs) {
  if (drawn) send({ seek_us: Math.round(Math.min(Math.max(tUs, drawn.meta.t_start_us), drawn.meta.t_end_us)) });
}

function pick(id, move) {
  const select = $(id);
  select.selectedIndex = (select.selectedIndex + move + select.length) % select.length;
  select.dispatchEvent(new Event("change"));
}

function choose(step) {
  const markers = hello?.reference_px.length;
  if (markers) setOption("marker", (sensor.options.marker + step + markers) % markers);
}

function legendTexts() {
  return [...$("legend").children].map((entry) => entry.textContent.trim()).filter(Boolean);
}

const toggleTheme = startTheme(redraw);
const toggle = (id) => () => $(id).click();
listen({
  " ": () => $("play").click(), "d": toggleTheme, "?": () => $("keys").showModal(),
  "ArrowLeft": (shift) => drawn && seek(drawn.meta.t_us - (shift ? 1e5 : 1e4)), "ArrowRight": (shift) => drawn && seek(drawn.meta.t_us + (shift ? 1e5 : 1e4)),
  "Home": () => drawn && seek(drawn.meta.t_start_us), "i": () => pick("image", 1),
  "a": toggle("arrows"), "h": toggle("heat"), "g": toggle("mesh"), "c": toggle("discs"), "t": toggle("truth"),
  "[": () => $("speed").selectedIndex > 0 && pick("speed", -1), "]": () => $("speed").selectedIndex < $("speed").length - 1 && pick("speed", 1),
  "-": () => { $("scale").stepDown(); setOption("scale", Number($("scale").value)); },
  "+": () => { $("scale").stepUp(); setOption("scale", Number($("scale").value)); },
  "n": () => choose(1), "p": () => choose(-1),
});
$("play").addEventListener("click", () => send({ play: !(drawn?.meta.playing ?? false) }));
$("speed").addEventListener("change", (event) => send({ speed: Number(event.target.value) }));
$("timeline").addEventListener("input", (event) => { scrubbing = true; seek(Number(event.target.value)); });
$("timeline").addEventListener("change", () => { scrubbing = false; });
$("image").addEventListener("change", (event) => setOption("image", event.target.value));
$("exposure").addEventListener("input", (event) => {
  const share = event.target.value / 100, [low, high] = EXPOSURES_MS.map(Math.log);
  const exposureMs = Math.exp(low + share * (high - low));
  $("exposure-text").value = `${exposureMs.toPrecision(2)} ms`;
  send({ exposure_us: Math.round(exposureMs * 1000) });
});
$("scale").addEventListener("input", (event) => setOption("scale", Number(event.target.value)));
for (const id of LAYERS) $(id).addEventListener("change", (event) => setOption(id, event.target.checked));
$("defaults").addEventListener("click", () => { forget(); send({ defaults: true }); });
$("calibrate").addEventListener("click", () => send({ calibrate: true }));
$("begin-anew").addEventListener("click", () => send({ begin_anew: true }));
$("save").addEventListener("click", () => hello && saveTable(course, hello, hello.label));
$("picture").addEventListener("click", () => drawn && savePicture(sensor, hello.label, [$("clock").value, ...legendTexts()]));
$("theme").addEventListener("click", toggleTheme);
$("help").addEventListener("click", () => $("keys").showModal());
$("sensor").addEventListener("click", (event) => {
  const marker = hello && sensor.markerAt(event);
  if (marker !== null && marker !== undefined) setOption("marker", marker);
});
onResize(redraw);
setInterval(() => { if (metrics.connected && drawn && performance.now() - receivedAt > STALE_MS) setState("STALE", drawn.meta.failure); }, 500);
connect();
